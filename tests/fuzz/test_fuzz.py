"""Readers of outside data, given what is damaged: they take it, or say in one line what is wrong.

For long: `scripts/fuzz TARGET --hours 2`.
"""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from fuzz_all import LEDGER, minutes_of, next_of
from fuzz_keep import unpack
from fuzz_structures import INPUTS
from fuzz_targets import TARGETS
from hypothesis import given, settings

_MUTANTS = 12
_GROWN = 25
"""How many of the inputs that fuzzing has found for a target are read; a reading takes some milliseconds."""
_EXAMPLES = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


def changed(data: bytes, draw: random.Random) -> bytes:
    """Cut an input, flip bits of it, or put a part of it in another place."""
    content = bytearray(data)
    if not content or draw.random() < 0.2:
        return bytes(content[: draw.randrange(len(content) + 1)])
    if draw.random() < 0.2:
        start = draw.randrange(len(content))
        place = draw.randrange(len(content))
        content[place:place] = content[start : start + draw.randrange(64)]
    for _ in range(draw.choice([1, 2, 8])):
        content[draw.randrange(len(content))] = draw.choice([0, 255, 10, 45, draw.randrange(256)])
    return bytes(content)


@pytest.mark.parametrize("name", TARGETS)
def test_bytes_are_taken_or_refused_in_one_line(name: str, folder: Path) -> None:
    target, draw = TARGETS[name], random.Random(1)
    seeds = list(target.seeds())
    for seed in seeds:
        target.run(seed, folder)
    for _ in range(_MUTANTS):
        target.run(changed(draw.choice(seeds), draw), folder)


@pytest.mark.parametrize("name", TARGETS)
def test_what_fuzzing_has_found_is_taken_or_refused_in_one_line(name: str, folder: Path, tmp_path: Path) -> None:
    unpack(name, tmp_path)
    found = sorted(tmp_path.iterdir())
    for path in random.Random(1).sample(found, min(_GROWN, len(found))):
        TARGETS[name].run(path.read_bytes(), folder)


@pytest.mark.parametrize("name", INPUTS)
def test_what_is_nearly_right_is_taken_or_refused_in_one_line(name: str, folder: Path) -> None:
    target = TARGETS[name]

    @settings(max_examples=_EXAMPLES, database=None)
    @given(INPUTS[name])
    def read(data: bytes) -> None:
        target.run(data, folder)

    read()


def test_who_has_had_least_is_fuzzed_next(folder: Path) -> None:
    runs = folder / "runs.csv"
    assert not minutes_of(runs)
    runs.write_text(
        "target,processor_minutes,inputs,new,last_new_minute\na,10.0,5,1,2.0\na,4.5,5,1,2.0\nb,12.0,9,0,0.0\n"
    )
    had = minutes_of(runs)
    assert had == {"a": 14.5, "b": 12.0}
    assert minutes_of(runs, runs) == {"a": 29.0, "b": 24.0}
    assert set(minutes_of(LEDGER)) == {*TARGETS, *(f"{name}-structure" for name in INPUTS)}
    targets = ["a", "b", "c"]
    assert next_of(targets, had, set(), 20.0) == ("c", 10.0)
    assert next_of(targets, had, {"c"}, 20.0) == ("b", 8.0)
    assert next_of(targets, had, {"c", "b"}, 14.5) is None
