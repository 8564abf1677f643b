"""Compiled code that is kept is that of the sources; what it draws is numpy's; and arithmetic has a digest."""

import enum
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from common import run_program
from skd_sim.kernels.compilation import digest_of, kernel
from skd_sim.kernels.stream import Stream, stream_of
from skd_sim.world.state import FloatArray

NUMBERS = """
GRAVITY = 9.81
"""
HELPERS = """
from skd_sim.kernels.compilation import kernel
import numbers_of_mine

@kernel
def fall(seconds):
    return 0.5 * numbers_of_mine.GRAVITY * seconds * seconds

@kernel(inline=True)
def doubled(value):
    return 2.0 * value
"""
MODEL = """
from typing import NamedTuple
from skd_sim.kernels.compilation import bound, kernel, template
import helpers_of_mine
from helpers_of_mine import doubled

class Parameters(NamedTuple):
    near: float
    far: float

@kernel
def step(parameters, seconds):
    return doubled(helpers_of_mine.fall(seconds)) + parameters.far

_step = None

@template(inline=False)
def _search_template(parameters, seconds):
    return _step(parameters, seconds)

print(bound(_search_template, "mine", {"_step": step})(Parameters(near=1.0, far=100.0), 2.0))
"""


def run(folder: Path, script: str = "model.py") -> subprocess.CompletedProcess[str]:
    """Run a script in a process of its own, as another session would."""
    cache = str(folder / "cache")
    return run_program(sys.executable, script, cwd=folder, SKD_CACHE_DIR=cache, PYTHONDONTWRITEBYTECODE="1")


def answer(folder: Path) -> float:
    done = run(folder)
    assert (done.returncode, done.stderr) == (0, "")
    return float(done.stdout)


def kept(folder: Path) -> set[str]:
    return {path.name for path in (folder / "cache" / "kernels").iterdir()}


def write_sources(folder: Path) -> Path:
    (folder / "numbers_of_mine.py").write_text(NUMBERS)
    (folder / "helpers_of_mine.py").write_text(HELPERS)
    (folder / "model.py").write_text(MODEL)
    return folder


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    return write_sources(tmp_path)


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources, and what a first process has compiled of them."""
    folder = write_sources(tmp_path_factory.mktemp("once"))
    assert answer(folder) == pytest.approx(139.24)
    return folder


@pytest.fixture
def compiled(once: Path, tmp_path: Path) -> Path:
    return shutil.copytree(once, tmp_path / "mine")


def test_code_is_kept_while_nothing_that_it_depends_on_changes(compiled):
    before = kept(compiled)
    assert any("_search_template" in name for name in before)
    (compiled / "helpers_of_mine.py").write_text(f"# a remark\n\n{HELPERS}\nUNUSED = 3.0\n")
    assert answer(compiled) == pytest.approx(2 * 0.5 * 9.81 * 4 + 100)
    assert kept(compiled) == before


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        ("numbers_of_mine.py", "9.81", "3.0", 112.0),
        ("helpers_of_mine.py", "return 2.0 * value", "return 3.0 * value", 158.86),
        ("model.py", "near: float\n    far: float", "far: float\n    near: float", 139.24),
    ],
    ids=["number-of-another-file", "inlined-helper", "order-of-fields"],
)
def test_a_change_anywhere_below_a_kernel_counts(compiled, file, old, new, expected):
    text = (compiled / file).read_text()
    assert old in text
    (compiled / file).write_text(text.replace(old, new))
    assert answer(compiled) == pytest.approx(expected)


@kernel
def step(value: float) -> float:
    return value + 1.0


@kernel
def step2(value: float) -> float:
    return value + 2.0


def test_two_models_of_one_name_do_not_share_code_on_disk(compiled):
    """They come one after the other, in processes of their own."""
    other = MODEL.replace('{"_step": step}', '{"_step": step2}')
    other = other.replace(
        "_step = None", "@kernel\ndef step2(parameters, seconds):\n    return seconds\n\n_step = None", 1
    )
    (compiled / "model.py").write_text(other)
    assert answer(compiled) == 2.0


class Place(NamedTuple):
    x: float
    y: float = 0.0


class Kind(enum.IntEnum):
    ONE = 1
    TWO = 2


def reading(value: Any) -> Callable[..., Any]:
    """Return a function that reads a global of this value."""
    code = compile("def reads():\n    return VALUE\n", "somewhere", "exec")
    namespace = {"VALUE": value, "__name__": "somewhere"}
    exec(code, namespace)
    return namespace["reads"]


VALUES: list[Any] = [
    0, 0.0, -0.0, 1, 1.0, True, None, "1", b"1", 1j, float("inf"), np.float32(1.0), np.float64(1.0),
    np.array([1.0]), np.array([1]), np.array([[1.0]]), np.array([1.0, 2.0]), (1.0,), (1.0, 2.0), [1.0], (1, 2.0),
    Place(1.0, 2.0), Kind.ONE, Kind.TWO, Kind, Place, step, step2, min, max, np.sqrt, np.exp, float, np.float32,
]  # fmt: skip


def test_digest_tells_every_two_values_apart_and_repeats():
    digests = [digest_of(reading(value)) for value in VALUES]
    assert len(set(digests)) == len(VALUES)
    assert [digest_of(reading(value)) for value in VALUES] == digests


def test_what_cannot_be_told_apart_is_not_kept():
    for value in (object(), np.array([None])):
        assert digest_of(reading(value)) is None


def test_first_runs_at_once_neither_disturb_each_other_nor_differ(mine):
    with ThreadPoolExecutor(2) as pool:
        answers = list(pool.map(answer, [mine] * 2))
    assert answers[0] == answers[1]
    left = kept(mine)
    assert answer(mine) == pytest.approx(139.24)
    assert kept(mine) == left
    assert all(name.endswith(".kernel") and not name.startswith(".") for name in left)


def test_a_cache_that_cannot_be_written_costs_time_only(mine):
    """As on a full disk."""
    (mine / "full.py").write_text(
        "import resource, runpy\nresource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n"
        "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\nrunpy.run_path('model.py')\n"
    )
    done = run(mine, "full.py")
    assert float(done.stdout) == pytest.approx(139.24), done.stderr
    assert kept(mine) == set()


_COUNT = 3000  # normals beyond the ziggurat's last layer, 1 in 3,700, are drawn by another way: twice that many draws


@kernel
def _draw(reals: FloatArray, halves: np.ndarray, rng: np.random.Generator) -> None:
    for i in range(reals.shape[0]):
        reals[i, 0] = rng.random()
        reals[i, 1] = rng.standard_normal()
        halves[i] = rng.integers(0, 1_000_000, dtype=np.int32)  # of 32 bits: every other one is kept for the next call
        reals[i, 2] = rng.standard_normal()


def _drawn(rng: np.random.Generator) -> tuple[FloatArray, np.ndarray]:
    reals, halves = np.empty((_COUNT, 3)), np.empty(_COUNT, np.int32)
    _draw(reals, halves, rng)
    return reals, halves


def _generators() -> tuple[np.random.Generator, np.random.Generator]:
    return np.random.Generator(np.random.PCG64(30)), np.random.Generator(np.random.PCG64(30))


def test_kernels_draw_from_a_stream_what_numpy_draws() -> None:
    numpys, ours = _generators()
    reals, halves = _drawn(stream_of(ours))
    for real, half in zip(reals.tolist(), halves.tolist(), strict=True):
        assert real[0] == numpys.random()
        assert real[1] == numpys.standard_normal()
        assert half == numpys.integers(0, 1_000_000, dtype=np.int32)
        assert real[2] == numpys.standard_normal()
    assert ours.bit_generator.state == numpys.bit_generator.state


def test_generator_and_stream_draw_in_turns() -> None:
    expected, ours = _generators()
    stream = stream_of(ours)
    assert isinstance(stream, Stream)
    for turn in range(6):
        ours.integers(0, 10, dtype=np.int32) if turn % 2 else stream.integers(0, 10, dtype=np.int32)
        expected.integers(0, 10, dtype=np.int32)
        _drawn(stream)
        _drawn(expected)
    assert ours.bit_generator.state == expected.bit_generator.state
