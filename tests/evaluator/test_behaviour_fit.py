"""Behaviour models that are fitted: simulated people are found again, and people held out are predicted."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from skd_evaluator.bags.checks import Damage
from skd_evaluator.cli.main import main
from skd_evaluator.metrics.behaviour.model import (
    NAMES,
    OF_PERSON,
    OF_TICK,
    Behaviour,
    load_behaviour,
    normals_of,
    walked,
)
from skd_evaluator.risk.behaviour.fit import FITTED, fit_behaviour, inverted, simulated
from skd_evaluator.risk.behaviour.tracks import read_tracks
from skd_sim.errors import UsageError

pytestmark = pytest.mark.usefixtures("pictures_drawn")

LENGTHS = [28] * 40


def people(seed: int, lengths: list[int] = LENGTHS) -> list[np.ndarray]:
    """Simulated walkers, by the shipped model."""
    chance = np.random.default_rng(seed).standard_normal((len(lengths), normals_of(max(lengths) - 1)))
    ways = simulated(load_behaviour("walkers").values, lengths, 1.25, 0.3, chance)
    return [way[np.isfinite(way[:, 0])] for way in ways]


@pytest.fixture(scope="module")
def fit():
    return fit_behaviour(people(5), 0.3)


def test_parameters_are_found_again_within_their_intervals(fit):
    truth = load_behaviour("walkers").values
    inside = [low <= truth[NAMES.index(name)] <= high for name, (low, high) in fit.intervals.items()]
    assert set(fit.intervals) == set(FITTED)
    assert sum(inside) >= len(FITTED) - 2  # each is at 95 %; docs/metrics.md says how often they are
    for name, most in (("turn", 0.35), ("sway", 0.35), ("hesitation_time", 0.5)):
        place = NAMES.index(name)
        assert fit.values[place] == pytest.approx(truth[place], rel=most)


def write_csv(folder: Path, ways: list[np.ndarray]) -> None:
    folder.mkdir()
    for number, way in enumerate(ways):
        rows = "".join(f"{0.3 * tick!r},{x!r},{y!r}\n" for tick, (x, y) in enumerate(way.tolist()))
        (folder / f"{number:03}.csv").write_text(f"t,x,y\n{rows}", encoding="utf-8")


def test_tracks_are_read_from_csv(tmp_path):
    ways = people(2, [20, 25, 6])
    write_csv(tmp_path / "csv", ways)
    found = read_tracks([tmp_path / "csv"], Damage())
    assert [one.name for one in found] == ["000", "001"]  # the third is too short for a residual
    np.testing.assert_allclose(found[1].positions, ways[1], atol=1e-9)
    with pytest.raises(UsageError, match="no track of at least 3 s; 1 shorter"):
        read_tracks([tmp_path / "csv" / "002.csv"], Damage())


def test_the_command_writes_a_model_that_says_how_well_it_predicts(tmp_path, capsys):
    write_csv(tmp_path / "csv", people(7, [24] * 12))
    code = main(["fit", "--people", str(tmp_path / "csv"), "--out", str(tmp_path / "out"), "--name", "mine", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert code == 0
    model = load_behaviour(tmp_path / "out")
    assert model.name == said["name"] == "mine"
    assert model.parameters["turn"].source == "fitted to 12 tracks of 12 recordings"
    validation = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert validation == said["validation"]
    assert [row["horizon"] for row in validation["residuals"][::3]] == [0.6, 1.2, 2.4]
    assert validation["worst"] < 1.0  # of 12 people, who are of the model
    assert (tmp_path / "out" / "behaviour.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "nowhere: cannot be read"),
        (["csv", "--kind", "duck"], "--kind must be one of pedestrian"),
        (["csv"], r"9 tracks, of which 6 are left .* needs at least 8"),
    ],
)
def test_what_cannot_be_fitted_is_refused(words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_csv(tmp_path / "csv", people(7, [20] * 9))
    assert main(["fit", "--people", *words, "--out", "out"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert re.search(said, lines[0])


MIXED = np.array([[1.0, 0.0], [0.7, 1.0], [0.2, -1.0]])
QUANTILE = 1.959964


class Mixed:
    """Three numbers that two parameters are mixed into, with noise that grows with the first."""

    def __init__(self, wanted: np.ndarray, growth: float) -> None:
        self.observed, self._growth = wanted, growth
        self._noise = np.random.default_rng(3).standard_normal((20_000, 3))

    def allowed(self, free: np.ndarray) -> np.ndarray:
        return np.maximum(free, 0.0)

    def summary_at(self, free: np.ndarray) -> np.ndarray:
        return MIXED @ free

    def jacobian_at(self, free: np.ndarray) -> np.ndarray:
        return MIXED

    def groups_at(self, free: np.ndarray) -> np.ndarray:
        return MIXED @ free + (0.1 + self._growth * free[0]) * self._noise


@pytest.mark.parametrize(("first", "growth"), [(1.0, 0.0), (1.0, 0.3), (0.05, 0.0), (0.0, 0.3)])
def test_the_interval_is_the_one_in_closed_form(first, growth):
    """The estimate is x ± z·(a + g·θ)·c at a value θ: so the ends are (x ∓ z·a·c) / (1 ± z·g·c), and at least 0."""
    estimate = np.array([first, 2.0])
    unit = np.sqrt(np.linalg.inv(MIXED.T @ MIXED)[0, 0]) * QUANTILE
    low = max((first - 0.1 * unit) / (1.0 + growth * unit), 0.0)
    high = (first + 0.1 * unit) / (1.0 - growth * unit)
    problem = Mixed(MIXED @ estimate, growth)
    found = inverted(problem, estimate, 0, unit * (0.1 + growth * first) / QUANTILE, most=50.0)
    assert found == (pytest.approx(low, abs=0.03), pytest.approx(high, rel=0.06, abs=0.01))


STEP = 0.3
STRAIGHT = np.column_stack([np.arange(21) * 0.45, np.zeros(21)])  # 1.5 m/s, 6 s
TICKS = 40


def values(**changes: float) -> np.ndarray:
    """Parameters of a pedestrian who does nothing but what these say."""
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


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"parameters": {"pase": {"value": 0.1, "source": "x"}}}, "unknown key parameters.pase; .* mean 'pace'"),
        ({"pace": {"value": 7.0, "source": "x"}}, r"parameters.pace.value must be a number from 0 to 1, got 7"),
        ({"pace": {"value": 0.1, "source": " "}}, "parameters.pace: source must say where"),
        ({"pace": {"value": 0.1, "source": "x", "interval_95": [0.2, 0.3]}}, "interval_95 must hold the value 0.1"),
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
