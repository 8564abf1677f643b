"""Copies of a controller, quickly: thousands of them are made for every decision.

What cannot change is shared; lists, arrays and objects of plain classes are copied here, all others by `copy.deepcopy`.
Random generators that a controller keeps are copied as they are, or seeded anew: a copy that went on with that of the
original would foresee what the original is about to draw.
"""

from __future__ import annotations

import copy
import enum
import types
from collections import deque
from typing import Any, Final

import numpy as np

from skd_sim.encounter.scenario import Scenario

_SHARED: Final = frozenset(
    {
        int,
        float,
        complex,
        bool,
        str,
        bytes,
        range,
        type(None),
        type(...),
        type,
        types.FunctionType,
        types.BuiltinFunctionType,
        types.ModuleType,
        Scenario,
        np.float64,
        np.float32,
        np.int64,
        np.int32,
        np.bool_,
    }
)
"""Types whose objects nobody changes, or whose state is nobody's own."""

_OWN_WAY = ("__deepcopy__", "__setstate__", "__getnewargs__", "__getnewargs_ex__")

Memo = dict[int, Any]


class Copier:
    """Copies controllers, and whatever else belongs to a future.

    It remembers which classes are plain, so keep one for an episode.
    """

    def __init__(self, *shared: object) -> None:
        """Share these objects between all copies: nobody changes them."""
        self._kept = shared
        self._memo: Memo = {id(one): one for one in shared}
        self._plain: dict[type[Any], bool] = {}

    def copy(self, original: Any) -> Any:
        """Return a copy that goes on as the original would, its generators included."""
        return self._copy(original, dict(self._memo))

    def _copy(self, one: Any, memo: Memo) -> Any:
        kind = type(one)
        if kind in _SHARED or isinstance(one, enum.Enum):
            return one
        found = memo.get(id(one))
        if found is not None:
            return found
        made: Any
        if kind is dict:
            made = memo[id(one)] = {}
            for key, value in one.items():
                made[key if type(key) in _SHARED else self._copy(key, memo)] = (
                    value if type(value) in _SHARED else self._copy(value, memo)
                )
            return made
        if kind is list:
            made = memo[id(one)] = []
            made.extend([item if type(item) in _SHARED else self._copy(item, memo) for item in one])
            return made
        if kind is deque:
            made = memo[id(one)] = deque(maxlen=one.maxlen)
            made.extend([item if type(item) in _SHARED else self._copy(item, memo) for item in one])
            return made
        if isinstance(one, tuple):
            return self._copied_tuple(one, kind, memo)
        if kind is np.ndarray and not one.dtype.hasobject:
            if not one.flags.writeable and one.base is None:
                return one
            made = memo[id(one)] = one.copy(order="K")
            return made
        if kind is types.MethodType:
            return types.MethodType(one.__func__, self._copy(one.__self__, memo))
        if self._is_plain(kind):
            made = memo[id(one)] = object.__new__(kind)
            state = made.__dict__
            for key, value in one.__dict__.items():
                state[key] = value if type(value) in _SHARED else self._copy(value, memo)
            return made
        return copy.deepcopy(one, memo)

    def _copied_tuple(self, one: Any, kind: type[Any], memo: Memo) -> Any:
        for item in one:
            if type(item) not in _SHARED:
                break
        else:
            return one
        items = [self._copy(item, memo) for item in one]
        if all(new is old for new, old in zip(items, one, strict=True)):
            return one
        if kind is tuple:
            return memo.setdefault(id(one), tuple(items))
        if hasattr(one, "_make"):
            return memo.setdefault(id(one), kind._make(items))
        return copy.deepcopy(one, memo)

    def _is_plain(self, kind: type[Any]) -> bool:
        """Return whether all that objects of a class hold is in their `__dict__`, and nothing says otherwise."""
        found = self._plain.get(kind)
        if found is None:
            slots = any("__slots__" in vars(base) for base in kind.__mro__[:-1])
            own_way = any(hasattr(kind, name) for name in _OWN_WAY) or any(
                getattr(kind, name) is not getattr(object, name)
                for name in ("__reduce__", "__reduce_ex__", "__getstate__", "__new__")
                if hasattr(object, name)
            )
            builtin = any(base is not object and not base.__flags__ & 1 << 9 for base in kind.__mro__)  # no heap type
            found = self._plain[kind] = not (slots or own_way or builtin)
        return found
