"""Kernels draw from a stream what numpy draws from its generator, and leave the same state behind."""

from __future__ import annotations

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.kernels.stream import Stream, stream_of

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


def test_a_stream_keeps_its_generator_alive() -> None:
    stream = stream_of(np.random.Generator(np.random.PCG64(30)))
    expected, _ = _generators()
    ballast = [np.full(16, 7, np.uint64) for _ in range(1000)]  # where a freed state would have been
    np.testing.assert_array_equal(_drawn(stream)[0], _drawn(expected)[0])
    assert len(ballast) == 1000
