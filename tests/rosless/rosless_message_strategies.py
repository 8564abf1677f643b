"""Random message contents, as plain data that both kinds of message classes are made from."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

_RANGES = {
    name: (int(np.iinfo(name).min), int(np.iinfo(name).max))
    for name in ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"]
}
_RANGES["char"] = _RANGES["uint8"]
MAX_LENGTH = 4


def fresh_typestore() -> Typestore:
    """rosbags' own typestore with rosbags' own classes."""
    return get_typestore(Stores.ROS2_JAZZY)


def contents(store: Typestore, name: str) -> st.SearchStrategy[dict[str, Any]]:
    """Member name -> value; a nested message is a dict again."""
    fields = store.fielddefs[name][1]
    return st.fixed_dictionaries({field: _value(store, description) for field, description in fields})


def _value(store: Typestore, description: Any) -> st.SearchStrategy[Any]:
    kind, content = description
    if kind == Nodetype.NAME:
        return contents(store, content)
    if kind == Nodetype.BASE:
        return _scalar(content)
    item, size = content
    bounds = (size, size) if kind == Nodetype.ARRAY else (0, min(size or MAX_LENGTH, MAX_LENGTH))
    return st.lists(_value(store, item), min_size=bounds[0], max_size=bounds[1])


def _scalar(base: tuple[str, int]) -> st.SearchStrategy[Any]:
    name, bound = base
    if name == "string":
        text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)
        return text.filter(lambda value: not bound or len(value.encode()) <= bound)
    if name == "bool":
        return st.booleans()
    if name in ("float32", "float64"):
        return st.floats(width=32 if name == "float32" else 64)
    if name == "byte":
        return st.integers(0, 127)
    return st.integers(*_RANGES[name])


def build(store: Typestore, name: str, values: dict[str, Any], *, ours: Any = None) -> Any:
    """A message of rosbags' class, or of ours if its factory is given."""
    members: dict[str, Any] = {}
    for field, (kind, content) in store.fielddefs[name][1]:
        value = values[field]
        if kind == Nodetype.NAME:
            value = build(store, content, value, ours=ours)
        elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (item_kind, item), _ = content
            if item_kind == Nodetype.NAME:
                value = [build(store, item, element, ours=ours) for element in value]
            elif ours is None and item[0] != "string":
                value = np.array(value, dtype=_DTYPES.get(item[0], item[0]))
            elif item[0] == "byte":
                value = [bytes([element]) for element in value]
        elif ours is not None and content[0] == "byte":
            value = bytes([value])
        members[field] = value
    if ours is not None:
        return ours(name)(**members)
    return store.types[name](**members)


_DTYPES = {"char": "uint8", "byte": "int8", "bool": "bool"}
