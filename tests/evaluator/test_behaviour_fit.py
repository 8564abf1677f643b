"""Behaviour models that are fitted: simulated people are found again, and people held out are predicted."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skd_evaluator.bags.checks import Damage
from skd_evaluator.cli.main import main
from skd_evaluator.metrics.behaviour.model import MEANINGS, NAMES, load_behaviour, normals_of
from skd_evaluator.risk.behaviour.fit import FITTED, fit_behaviour, simulated
from skd_evaluator.risk.behaviour.tracks import Tracked, folds_of, read_tracks
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
    assert sum(inside) >= len(FITTED) - 2  # each is at 95 %; docs/risk.md says how often they are
    for name, most in (("turn", 0.35), ("sway", 0.35), ("hesitation_time", 0.5)):
        place = NAMES.index(name)
        assert fit.values[place] == pytest.approx(truth[place], rel=most)


def test_recordings_are_held_out_whole():
    tracks = [Tracked(f"clip {number % 6}", str(number), np.zeros((20, 2))) for number in range(30)]
    by, folds = folds_of(tracks)
    assert by == "recording"
    assert set(folds) == {0, 1, 2, 3}
    for name in {one.recording for one in tracks}:
        assert len({fold for one, fold in zip(tracks, folds, strict=True) if one.recording == name}) == 1
    assert folds_of([replace(one, recording="one") for one in tracks])[0] == "person"


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
    with pytest.raises(UsageError, match="no track of at least 3 s in it; 1 shorter"):
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


def test_people_who_never_hesitate_tell_nothing_of_how_long_they_would():
    """Such people had ended in `LinAlgError: Singular matrix`."""
    rng = np.random.default_rng(1)
    steps = np.column_stack([rng.normal(1.4, 0.1, 12), rng.normal(0.0, 0.1, 12)])[:, None] * 0.3
    ways = np.cumsum(steps + rng.normal(0.0, 0.01, (12, 18, 2)), axis=1)
    found = fit_behaviour(list(ways), 0.3, intervals=False)
    meaning = MEANINGS["hesitation_time"]
    assert found.intervals["hesitation_time"] == (meaning.low, meaning.high)
    assert all(low <= high for low, high in found.intervals.values())
    assert np.isfinite(found.values).all()


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
