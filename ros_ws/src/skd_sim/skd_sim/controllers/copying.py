"""Copies of a controller, quickly: thousands of them are made for every decision.

What cannot change is shared; lists, arrays and objects of plain classes are copied here, all others by `copy.deepcopy`.
Random generators that a controller keeps are copied as they are, or seeded anew: a copy that went on with that of the
original would foresee what the original is about to draw.
"""

from __future__ import annotations

import copy
import enum
import gc
import random
import types
from collections import deque
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from skd_sim.encounter.scenario import Scenario
from skd_sim.errors import UsageError

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
"""Types whose objects nobody changes, or whose state is nobody's own: what hides in a function or a module is found by
`skd_adversary.itself.fidelity`."""

_OWN_WAY = ("__deepcopy__", "__setstate__", "__getnewargs__", "__getnewargs_ex__")
_DRAWING = (np.random.Generator, np.random.RandomState, np.random.BitGenerator, random.Random)
_LARGEST = 2**63 - 1

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

    def afresh(self, original: Any, rng: np.random.Generator) -> Any:
        """Return a copy whose generators, wherever it keeps them, are seeded anew from `rng`.

        Raises:
            UsageError: it keeps one that cannot be seeded.
        """
        made = self.copy(original)
        for one in drawing(made):
            seed_anew(one, int(rng.integers(_LARGEST)))
        return made

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


def drawing(one: object) -> Iterator[Any]:
    """Yield the random generators that an object keeps, each once, in an order that depends on the object alone."""
    seen: set[int] = set()
    waiting: deque[Any] = deque([one])
    while waiting:
        item = waiting.popleft()
        if id(item) in seen or isinstance(item, (type, types.ModuleType, types.FunctionType, Scenario)):
            continue
        seen.add(id(item))
        if isinstance(item, _DRAWING):
            if isinstance(item, np.random.Generator):
                seen.add(id(item.bit_generator))
            yield item
            continue
        if type(item) in _SHARED or (isinstance(item, np.ndarray) and not item.dtype.hasobject):
            continue
        if isinstance(item, (set, frozenset)):
            continue  # its order is nobody's; what is hashed in one is no generator that anybody draws from
        waiting.extend(gc.get_referents(item))


def seed_anew(one: Any, seed: int) -> None:
    """Have a random generator go on from another seed.

    Raises:
        UsageError: it cannot be seeded.
    """
    try:
        if isinstance(one, random.Random):
            one.seed(seed)
            return
        bits = one if isinstance(one, np.random.BitGenerator) else getattr(one, "bit_generator", None)
        if bits is None:  # RandomState
            bits = one._bit_generator
        bits.state = type(bits)(seed).state
    except Exception as error:
        raise UsageError(
            f"the car keeps a generator of {type(one).__name__} that cannot be seeded anew ({type(error).__name__}): "
            "knowledge itself would foresee its draws"
        ) from None
