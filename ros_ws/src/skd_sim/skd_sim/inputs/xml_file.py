"""XML of others, read with care: no document type, so no entities of its own and none from elsewhere, and not too much.

A short text with entities can mean gigabytes, or the content of another file; a text of opening tags alone ends a
parser. Files of the formats that SKD reads have no document type, so one that has is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers.expat import ExpatError, ParserCreate

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import LARGEST, read_bytes

DEEPEST = 60
"""Levels of elements; those of OpenSCENARIO are 20."""
_MOST = 2_000_000
"""Elements; each takes some two hundred bytes of memory."""


def read_xml(path: Path, largest: int = LARGEST) -> Element:
    """Return the root of an XML file; names have no namespaces.

    Raises:
        UsageError: it cannot be read, is too large, or is no XML as others may give it.
    """
    return parse_xml(read_bytes(path, largest), str(path))


def parse_xml(content: bytes, where: str) -> Element:
    """Return the root of a document.

    Args:
        content: its bytes.
        where: name of the file, for error lines.

    Raises:
        UsageError: it is no XML; has a document type; is nested deeper than `DEEPEST`, or has more than some million
            elements.
    """
    parser: Any = ParserCreate()
    builder = _Builder(where)
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.tree.data
    parser.StartDoctypeDeclHandler = builder.refuse
    parser.EntityDeclHandler = builder.refuse
    parser.ExternalEntityRefHandler = builder.refuse
    try:
        parser.Parse(content, True)
        return builder.tree.close()
    except (ExpatError, ValueError, LookupError) as error:  # LookupError: an encoding that nobody knows
        raise UsageError(f"{where}: not XML that SKD reads: {' '.join(str(error).split())[:160]}") from error


class _Builder:
    """Puts elements together, and counts them."""

    def __init__(self, where: str) -> None:
        self.tree = TreeBuilder()
        self._where, self._depth, self._count = where, 0, 0

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        self._count += 1
        if self._depth > DEEPEST:
            raise UsageError(f"{self._where}: not XML that SKD reads: it is nested deeper than {DEEPEST} levels")
        if self._count > _MOST:
            raise UsageError(f"{self._where}: not XML that SKD reads: it has more than {_MOST} elements")
        self.tree.start(tag.rpartition(":")[2], attributes)

    def end(self, tag: str) -> None:
        self._depth -= 1
        self.tree.end(tag.rpartition(":")[2])

    def refuse(self, *_declared: object) -> NoReturn:
        raise UsageError(f"{self._where}: not XML that SKD reads: it declares a document type or entities; remove them")
