"""Inputs that are put together as right ones are, and of which hypothesis then changes parts."""

from __future__ import annotations

import copy
import io
import json
import math
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from fuzz_targets import CORPUS, Target, arrays_of, as_messages, seed_arrays
from hypothesis import given, settings
from hypothesis import strategies as st
from skd_evaluator.fusion.figures import FIGURES

JUNK: list[Any] = [
    None, True, False, 0, -1, 1, 0.5, -0.0, 1e308, 5e-324, 2**31, 2**63, 2**64, -(2**63), 10**400, "", "abc", "\x1b[2J",
    "\u202e", "../x", "~x", "x" * 300, "a\x00b", "φ", [], {}, [1], [None], {"a": {"b": 1}}, [[0.0, 1.0]], math.nan,
    math.inf, -math.inf, "nan", "1e400", "2020-01-01",
]  # fmt: skip
"""What may stand where something else belongs."""
_values = st.one_of(
    st.sampled_from(JUNK).map(copy.deepcopy),  # what is put into one of them must not stand in all, nor in itself
    st.floats(),
    st.integers(),
    st.text(max_size=8),
    st.recursive(st.none() | st.booleans(), lambda inside: st.lists(inside) | st.dictionaries(st.text(), inside)),
)


def _leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path] if path else []
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, one in items:
        found += _leaves(one, (*path, key))
    return found


@cache
def _seed(target: str, name: str) -> str:
    content = (CORPUS / target / name).read_bytes()[1:].decode()
    return json.dumps(yaml.safe_load(content)) if name.endswith(".yaml") else content


@st.composite
def changed_document(draw: st.DrawFn, target: str, names: tuple[str, ...]) -> tuple[int, Any]:
    """Return the reader of a seed and its plain data, of which up to three parts are others, gone, new or moved."""
    name = draw(st.sampled_from(names))
    document = json.loads(_seed(target, name))
    for _ in range(draw(st.integers(1, 3))):
        places = _leaves(document)
        if not places:
            break
        *way, last = draw(st.sampled_from(places))
        inside = document
        for key in way:
            inside = inside[key]
        how = draw(st.sampled_from(["other", "other", "near", "gone", "new", "doubled"]))
        old = inside[last]
        if how == "gone":
            del inside[last]
        elif how == "near" and isinstance(old, (int, float)) and not isinstance(old, bool) and abs(old) < 2**53:
            inside[last] = draw(st.sampled_from([-old, old + 1, old * 2, old / 3, float(old), int(old)]))
        elif how == "new" and isinstance(inside, dict):
            inside[draw(st.text(max_size=4))] = draw(_values)
        elif how == "doubled" and isinstance(inside, list):
            inside.append(old)
        else:
            inside[last] = draw(_values)
    return (CORPUS / target / name).read_bytes()[0], document


def _as_json(document: Any) -> bytes:
    return json.dumps(document, ensure_ascii=False).encode("utf-8", "surrogatepass")


def _as_yaml(document: Any) -> bytes:
    return yaml.dump(document, allow_unicode=True, sort_keys=False).encode("utf-8", "surrogatepass")


_JSON = ("assessment.json", "probe.json", "cells.json", "campaign.json", "scenario.json", "options.json", "model.json")
_YAML = ("scenario.yaml", "versions.yaml", "sweep.yaml", "metadata.yaml")


@st.composite
def changed_arrays(draw: st.DrawFn) -> bytes:
    """Return an episodes.npz of which up to two arrays are others, with right checksums."""
    arrays = arrays_of(seed_arrays("assessed"))
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(sorted(arrays)))
        array = arrays[name]
        how = draw(st.sampled_from(["value", "value", "value", "type", "shorter", "longer", "shape", "gone"]))
        if how == "gone" and len(arrays) > 1:
            del arrays[name]
        elif how == "type":
            kinds = ["U3", "S3", "O", "f4", "f8", "i8", "u8", "c8", "?", ">f8", "M8[s]"]
            arrays[name] = np.zeros(array.shape, draw(st.sampled_from(kinds)))
        elif how == "shorter" and array.ndim:
            arrays[name] = array[: draw(st.integers(0, len(array)))]
        elif how == "longer" and array.ndim:
            arrays[name] = np.concatenate([array, array[:1]])
        elif how == "shape":
            arrays[name] = array[..., None]
        elif array.size:
            flat = array.reshape(-1).copy()
            place = draw(st.integers(0, flat.size - 1))
            if flat.dtype.kind == "U" and flat.dtype.itemsize and draw(st.booleans()):
                flat.view(np.uint32)[place] = draw(st.integers(0, 2**32 - 1))
            elif flat.dtype.kind == "U":
                flat = flat.astype("U16")
                flat[place] = draw(st.text(max_size=16).filter(lambda one: one.isprintable()))
            elif flat.dtype.kind == "f":
                with np.errstate(over="ignore"):
                    flat[place] = draw(st.floats())
            elif flat.dtype.kind == "b":
                flat[place] = not flat[place]
            elif flat.dtype.kind in "iu":
                info = np.iinfo(flat.dtype)
                near = st.integers(max(info.min, int(flat[place]) - 2), min(info.max, int(flat[place]) + 2))
                flat[place] = draw(near | st.integers(info.min, info.max))
            arrays[name] = flat.reshape(array.shape)
    written = io.BytesIO()
    np.savez(written, **arrays)
    return bytes([draw(st.integers(0, 1))]) + written.getvalue()


@cache
def _sent() -> list[tuple[int, bytes]]:
    data, place, found = (CORPUS / "cdr" / "episode").read_bytes(), 0, []
    while place < len(data):
        channel, size = struct.unpack_from("<BH", data, place)
        found.append((channel, data[place + 3 : place + 3 + size]))
        place += 3 + size
    return found


@st.composite
def changed_messages(draw: st.DrawFn) -> bytes:
    """Return the messages of an episode, of which some have other words, or are gone, doubled or cut."""
    messages = list(_sent())
    for _ in range(draw(st.integers(1, 3))):
        # First those that say most: the episode, and its result.
        place = draw(st.sampled_from([0, len(messages) - 1]) | st.integers(0, len(messages) - 1))
        channel, content = messages[place]
        how = draw(st.sampled_from(["word", "word", "word", "double", "text", "cut", "gone", "doubled", "channel"]))
        at = 4 * draw(st.integers(1, max(1, len(content) // 4 - 1)))
        if how == "word":
            new = struct.pack("<i", draw(st.integers(-(2**31), 2**31 - 1) | st.integers(-2, 60)))
            content = content[:at] + new + content[at + 4 :]
        elif how == "double":
            content = content[:at] + struct.pack("<d", draw(st.floats())) + content[at + 8 :]
        elif how == "text":
            new = draw(st.binary(max_size=6))
            content = content[:at] + new + content[at + len(new) :]
        elif how == "cut":
            content = content[:at]
        if how == "gone" and len(messages) > 1:
            del messages[place]
        elif how == "doubled":
            messages.append(messages[place])
        else:
            messages[place] = (draw(st.integers(0, 3)) if how == "channel" else channel, content)
    return as_messages(messages)


_cell = st.one_of(
    st.floats(-20, 20).map(repr),
    st.sampled_from(["", " ", "nan", "inf", "-0", "1e999", "0x1", "1_0", "٣", '"', "\x00", "1;2", "t", "x" * 40]),
)
_table = st.lists(st.lists(_cell, min_size=1, max_size=5), max_size=12)


@st.composite
def table(draw: st.DrawFn) -> bytes:
    """Return a csv file with a header that names at least some columns; half of them are of a way, nearly."""
    header, rows = "t,x,y", [[repr(0.3 * tick), repr(-3.5 + 0.6 * tick), "0.0"] for tick in range(12)]
    if draw(st.booleans()):
        del rows[draw(st.integers(1, len(rows))) :]
        for _ in range(draw(st.integers(0, 3))):
            row = draw(st.sampled_from(rows))
            row[draw(st.integers(0, len(row) - 1))] = draw(_cell | st.floats().map(repr))
    else:
        header = draw(
            st.sampled_from(["t,x,y", "x,y", "t,x,y,x", " t , x ,y", "\ufefft,x,y", "x_est,y_est,vel_est,id"])
        )
        rows = draw(_table)
    end = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    return end.join([header, *(",".join(row) for row in rows)]).encode("utf-8", "surrogatepass")


_RECORD = struct.Struct("<BddqqqdIIII")


@st.composite
def record(draw: st.DrawFn) -> bytes:
    """Return what a store keeps of an episode, of any numbers; its lengths are right, or not."""
    states, ages = draw(st.integers(0, 4)), draw(st.integers(0, 3))
    believed, reason = draw(st.sampled_from([0, states])), draw(st.binary(max_size=5))
    whole = st.integers(-(2**63), 2**63 - 1)
    head = (
        draw(st.integers(0, 255)), draw(st.floats()), draw(st.floats()), draw(whole), draw(whole), draw(whole),
        draw(st.floats()), states, believed, ages, len(reason),
    )  # fmt: skip
    count = 5 * states + 4 * believed + ages + draw(st.sampled_from([0, 0, 0, 1]))
    numbers = draw(st.lists(st.floats(), min_size=count, max_size=count))
    return b"\x01" + _RECORD.pack(*head) + struct.pack(f"<{count}d", *numbers) + reason


@st.composite
def recorded(draw: st.DrawFn) -> bytes:
    """Return the table of a recorded trial, of which some rows have other cells, are gone, doubled or much later."""
    header, *rows = (CORPUS / "trials" / "recorded.csv").read_bytes()[1:].decode().splitlines()
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, len(rows) - 1))
        cells = rows[place].split(",")
        how = draw(st.sampled_from(["cell", "cell", "cell", "gone", "doubled"]))
        if how == "cell":
            cells[draw(st.integers(0, len(cells) - 1))] = draw(_cell | st.floats().map(repr))
            rows[place] = ",".join(cells)
        elif how == "doubled":
            rows.append(rows[place])
        elif len(rows) > 1:
            del rows[place]
    return b"\x01" + "\n".join([header, *rows, ""]).encode("utf-8", "surrogatepass")


@st.composite
def trials(draw: st.DrawFn) -> bytes:
    """Return a table of trials of any cells."""
    names = draw(st.lists(st.sampled_from(["phi", "file", "gap", *FIGURES]), min_size=1, max_size=5))
    rows = draw(st.lists(st.lists(_cell, min_size=len(names), max_size=len(names)), max_size=6))
    return b"\x00" + "\n".join(",".join(row) for row in [names, *rows]).encode("utf-8", "surrogatepass")


def _model_or_result(one: tuple[int, Any]) -> bytes:
    reader, document = one
    return bytes([reader]) + (_as_yaml(document) if reader == _BEHAVIOUR else _as_json(document))


_BEHAVIOUR = 2  # its reader among those of `trials`

INPUTS: dict[str, st.SearchStrategy[bytes]] = {
    "yaml": changed_document("yaml", _YAML).map(lambda one: bytes([one[0]]) + _as_yaml(one[1])),
    "json": changed_document("json", _JSON).map(lambda one: bytes([one[0]]) + _as_json(one[1])),
    "car_model": changed_document("car_model", ("car_model.yaml",)).map(lambda one: b"\x00" + _as_yaml(one[1])),
    "npz": changed_arrays(),
    "cdr": changed_messages(),
    "csv": table(),
    "store": record(),
    "trials": st.one_of(
        changed_document("trials", ("behaviour.yaml", "ncap.json")).map(_model_or_result), recorded(), trials()
    ),
}
"""Inputs of a target; recordings (`mcap`) are framed by lengths and checksums, which bytes alone go around."""


def _test(name: str) -> Callable[[Target, Path], Any]:
    @cache
    def reading(target: Target, folder: Path) -> Any:
        @settings(max_examples=10)
        @given(INPUTS[name])
        def read(data: bytes) -> None:
            target.run(data, folder)

        return read

    return reading


STRUCTURES: dict[str, Callable[[Target, Path], Any]] = {name: _test(name) for name in INPUTS}
"""By target: a hypothesis test of it that writes into a folder."""
