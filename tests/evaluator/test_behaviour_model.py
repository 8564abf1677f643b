"""Behaviour models: their files, and how somebody walks by them."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from skd_evaluator.metrics.behaviour.model import (
    NAMES,
    OF_PERSON,
    OF_TICK,
    Behaviour,
    load_behaviour,
    normals_of,
    walked,
    write_behaviour,
)
from skd_evaluator.risk.behaviour.fit import padded, quantile_table, residuals
from skd_sim.errors import UsageError

STEP = 0.3
STRAIGHT = np.column_stack([np.arange(21) * 0.45, np.zeros(21)])  # 1.5 m/s, 6 s
TICKS = 40


def values(**changes: float) -> np.ndarray:
    """Parameters of somebody who does nothing but what is asked."""
    calm = dict.fromkeys(NAMES, 0.0) | {"pace_time": 1.0, "turn_time": 1.0, "hesitation_time": 1.0, "hesitation": 9.0}
    return np.array(list({**calm, "hesitation_depth": 1.0, **changes}.values()))


def normals(ticks: int = TICKS, **person: float) -> np.ndarray:
    found = np.zeros(normals_of(ticks))
    for name, value in person.items():
        found[OF_PERSON.index(name)] = value
    return found


@pytest.fixture
def walkers() -> Behaviour:
    return load_behaviour("walkers")


def test_the_pace_is_the_persons():
    way = walked(STRAIGHT, values(pace=np.log(2.0)), normals(pace=-1.0), 1.0, STEP)
    np.testing.assert_allclose(np.diff(way[:, 0]), 0.225, atol=1e-12)
    assert len(way) == TICKS + 1
    twice = walked(STRAIGHT, values(pace=np.log(2.0)), normals(pace=0.5), 2.0, STEP)
    np.testing.assert_allclose(twice, STRAIGHT[::2], atol=1e-12)


def test_who_sets_off_late_stands_and_who_sets_off_early_is_under_way():
    late = walked(STRAIGHT, values(start_delay=0.45), normals(start=1.0), 1.0, STEP)
    np.testing.assert_allclose(late[:4, 0], [0.0, 0.0, 0.225, 0.675], atol=1e-12)
    early = walked(STRAIGHT, values(start_delay=0.45), normals(start=-1.0), 1.0, STEP)
    np.testing.assert_allclose(early[:2, 0], [0.675, 1.125], atol=1e-12)


def test_a_heading_turns_the_way_and_keeps_its_length():
    way = walked(STRAIGHT, values(heading=0.1), normals(heading=2.0), 1.5, STEP)
    steps = np.diff(way, axis=0)
    np.testing.assert_allclose(np.arctan2(steps[:, 1], steps[:, 0]), 0.3, atol=1e-12)
    np.testing.assert_allclose(np.hypot(*steps.T), 0.45, atol=1e-12)


def test_doubt_beyond_the_threshold_slows_and_stops():
    doubts = {"hesitation": 1.0, "hesitation_depth": 0.5, "hesitation_time": 1e-3}
    still = normals()
    for doubt, share in ((1.0, 1.0), (2.0, 0.5), (3.0, 0.0), (9.0, 0.0)):
        still[len(OF_PERSON) + OF_TICK.index("doubt") :: len(OF_TICK)] = doubt
        way = walked(STRAIGHT, values(**doubts), still, 1.0, STEP)
        np.testing.assert_allclose(np.diff(way[:3, 0]), 0.45 * share, atol=1e-12)


def test_processes_keep_their_size_and_their_memory():
    """Simulated for long, pace and doubt have the stated variance and correlation."""
    ticks, rng = 60_000, np.random.default_rng(3)
    path = np.column_stack([np.arange(400_000) * 1e-3, np.zeros(400_000)])
    chance = np.zeros(normals_of(ticks))
    chance[len(OF_PERSON) + OF_TICK.index("pace") :: len(OF_TICK)] = rng.standard_normal(ticks)
    way = walked(path, values(pace_noise=0.2, pace_time=1.5), chance, 1.0, STEP)
    pace = np.log(np.diff(way[:, 0]) / 1e-3)
    assert pace.std() == pytest.approx(0.2, rel=0.03)
    assert np.corrcoef(pace[:-1], pace[1:])[0, 1] == pytest.approx(np.exp(-STEP / 1.5), abs=0.02)
    chance[:] = 0.0
    chance[len(OF_PERSON) + OF_TICK.index("doubt") :: len(OF_TICK)] = rng.standard_normal(ticks)
    # Half of the pace is lost at no doubt: what is lost is linear in it, nearly always.
    way = walked(path, values(hesitation=-5.0, hesitation_depth=0.1, hesitation_time=0.9), chance, 1.0, STEP)
    doubt = (1.0 - np.diff(way[:, 0]) / 1e-3) / 0.1 - 5.0
    keep = np.exp(-STEP / 0.9)
    assert doubt.std() == pytest.approx(1.0, rel=0.04)
    assert np.corrcoef(doubt[:-1], doubt[1:])[0, 1] == pytest.approx(2.0 * keep / (1.0 + keep**2), abs=0.01)


def test_residuals_are_those_of_constant_velocity():
    way = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [2.0, 2.0]])
    found = residuals(padded([way, way[:4]]), 2)
    np.testing.assert_allclose(found[0], [[-1.0, 1.0], [-2.0, 2.0]])
    np.testing.assert_allclose(found[1, 0], [-1.0, 1.0])
    assert np.isnan(found[1, 1]).all()
    table = quantile_table(padded([np.column_stack([np.arange(20) * 0.4, np.zeros(20)])]), STEP)
    np.testing.assert_allclose(table, 0.0, atol=1e-12)


def test_a_file_is_read_as_it_was_written(walkers, tmp_path):
    write_behaviour(tmp_path / "behaviour.yaml", walkers)
    for path in (tmp_path, tmp_path / "behaviour.yaml"):
        assert load_behaviour(path) == walkers


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kind": "duck"}, "unknown road user 'duck'; known are pedestrian"),
        ({"name": 3}, "name must be text"),
        ({"colour": "red"}, "unknown key colour; allowed: name, kind"),
        (
            {"parameters": {"pase": {"value": 0.1, "source": "x"}}},
            "unknown key parameters.pase; .* mean 'pace'",
        ),
        ({"parameters": {}}, "missing key parameters.start_delay"),
        ({"pace": {"value": 7.0, "source": "x"}}, r"parameters.pace.value must be a number from 0 to 1, got 7"),
        ({"pace": {"value": True, "source": "x"}}, "parameters.pace.value must be a finite number"),
        ({"pace": {"value": 0.1, "source": " "}}, "parameters.pace: source must say where"),
        ({"pace": {"value": 0.1, "source": "x", "interval_95": [0.1]}}, "interval_95 must be a list of 2 numbers"),
        ({"pace": {"value": 0.1, "source": "x", "interval_95": [0.2, 0.05]}}, "interval_95 must hold the value 0.1"),
        (
            {"pace": {"value": 0.1, "source": "x", "interval_95": [False, True]}},
            "interval_95.0. must be a finite",
        ),
        ({"pace": {"value": 0.1, "source": "x", "interval_95": [0.2, 0.3]}}, "interval_95 must hold the value 0.1"),
        ({"pace": {"value": 0.1, "source": "x", "interval_95": [0, 10**400]}}, "has more than 64 bits"),
        ({"pace": {"value": 10**400, "source": "x"}}, "has more than 64 bits"),
        ({"turn_time": {"value": 0.0, "source": "x"}}, "turn_time.value must be a number from 0.05 to 20 s"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(change, said, walkers, tmp_path):
    data = walkers.as_dict()
    for key, value in change.items():
        (data["parameters"] if key in NAMES else data)[key] = value
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(UsageError, match=said) as caught:
        load_behaviour(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
