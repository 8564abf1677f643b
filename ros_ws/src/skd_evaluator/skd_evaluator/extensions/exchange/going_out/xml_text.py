"""XML as it is written: numbers that come back to the last bit, and nothing that differs from run to run."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np


def number(value: float) -> str:
    """Return the shortest text that is read back as a number is, without an exponent, which decimals of XML lack."""
    return str(np.format_float_positional(float(value), trim="0"))


def add(parent: Element, tag: str, **attributes: str | float) -> Element:
    """Add an element with attributes, numbers among them, and return it."""
    texts = {key: one if isinstance(one, str) else number(one) for key, one in attributes.items()}
    return SubElement(parent, tag, texts)


def text(parent: Element, tag: str, content: str | float) -> Element:
    """Add an element that holds a text or a number, and return it."""
    found = SubElement(parent, tag)
    found.text = content if isinstance(content, str) else number(content)
    return found


def as_bytes(root: Element) -> bytes:
    """Return a document in UTF-8."""
    indent(root)
    return bytes(tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"
