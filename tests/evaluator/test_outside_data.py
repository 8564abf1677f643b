"""What others wrote: files that never begin or end, values where they cannot be."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from cli_support import SMALL, one_line
from skd_adversary.car_model_file import car_model_for_scenario, car_model_text, fitted_car
from skd_adversary.fitted_car import Calibration
from skd_adversary.safe_trajectories import table
from skd_adversary.warm_up import any_car_models
from skd_evaluator.bags.logs import read_recordings
from skd_evaluator.campaign.store.manifest import MANIFEST, write_manifests
from skd_evaluator.campaign.store.verification import folders_below, verify
from skd_evaluator.campaigns.campaign_file import read_campaign
from skd_evaluator.measure.behaviour.model import load_behaviour, write_behaviour
from skd_evaluator.report.history.runs import find_runs
from skd_evaluator.risk.asked import risk_asked
from skd_sim.encounter.scenario import load_scenario
from skd_sim.errors import UsageError

HERE = Path(__file__).parent
pytestmark = pytest.mark.usefixtures("pictures_drawn")


@pytest.fixture
def result(sweep: Path, tmp_path: Path) -> Path:
    """An assessment as older versions left it: nothing beside it says what its files were."""
    copy = tmp_path / "result"
    shutil.copytree(sweep / "synthetic" / "C_1", copy)
    (copy / MANIFEST).unlink()
    return copy


def change(folder: Path, edit: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "assessment.json"
    figures = json.loads(path.read_text())
    edit(figures)
    path.write_text(json.dumps(figures))


def change_arrays(folder: Path, **changes: Callable[[np.ndarray], np.ndarray]) -> None:
    path = folder / "episodes.npz"
    with np.load(path) as file:
        arrays = {name: file[name].copy() for name in file.files}
    for name, edit in changes.items():
        arrays[name] = edit(arrays[name])
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    "words",
    [
        "fuse circle circle", "compare circle .", "replay circle", "import circle", "assess --out circle",
    ],
)  # fmt: skip
def test_links_in_a_circle_lead_nowhere(here, skd_here, words):
    (here / "circle").symlink_to("circle")
    before = sorted(here.iterdir())
    one_line(skd_here(*words.split()), 2, "circle")
    assert sorted(here.iterdir()) == before


@pytest.mark.parametrize("words", ["list {}", "fuse {} {}", "assess --safe {}", "assess --out {}"])
def test_a_name_that_no_file_can_have_is_said_in_one_line(here, skd_here, words):
    before = sorted(here.iterdir())
    one_line(skd_here(*words.format(*["x" * 300] * 2).split()), 2, "ame too long")
    assert sorted(here.iterdir()) == before


def test_a_pipe_as_safe_trajectory_or_scenario_does_not_hold_it_up(here, skd_here):
    os.mkfifo(here / "x.csv")
    os.mkfifo(here / "x.yaml")
    done = skd_here("assess", *SMALL, "--safe", "x.csv", "--out", "out")
    one_line(done, 2, "x.csv: is no regular file")
    done = skd_here("assess", *SMALL, "--scenario", "x.yaml", "--out", "out")
    one_line(done, 2, "x.yaml")


# --- values that cannot be where they are


FORGED: dict[str, Callable[[dict[str, Any]], object]] = {
    "multiplier": lambda figures: figures.update(multiplier="abc"),
    "eta_max": lambda figures: figures.update(eta_max=0.0),
    "measures": lambda figures: next(iter(figures["objectives"].values())).update(measures=None),
    "reasons": lambda figures: figures.update(aborted_reasons=[1]),
    "scenario": lambda figures: figures["scenario"].pop("car"),
}


@pytest.mark.parametrize("name", FORGED)
@pytest.mark.parametrize("command", ["report", "compare"])
def test_a_value_of_another_kind_is_said_in_one_line(result, sweep, skd_here, name, command):
    change(result, FORGED[name])
    words = {
        "report": ["report", result, "--out", "r.html"],
        "compare": ["compare", sweep / "synthetic" / "C_0.5", result, "--out", "compared"],
    }[command]
    one_line(skd_here(*map(str, words)), 2, "assessment.json")


@pytest.mark.parametrize("name", ["impact_speed", "episode_id"])
def test_arrays_that_cannot_be_are_said_in_one_line(result, skd_here, name):
    def edit(values: np.ndarray) -> np.ndarray:
        values[-1 if name == "episode_id" else np.flatnonzero(np.isfinite(values))[0]] = -1
        return values

    change_arrays(result, **{name: edit})
    one_line(skd_here("report", str(result), "--out", "x.html"), 2, "episodes.npz")


def test_an_impact_speed_that_is_none_is_said_in_one_line(result, skd_here):
    change_arrays(result, impact_speed=lambda values: values * math.nan)
    one_line(skd_here("show", str(result), "--out", "shown"), 2, "episodes.npz: a collision has no impact speed")


@pytest.mark.parametrize("step", [0.0, math.nan])
def test_a_time_step_that_cannot_be_is_said_in_one_line(result, skd_here, step):
    change_arrays(result, time_step=lambda _values: np.float64(step))
    one_line(skd_here("show", str(result), "--out", "shown"), 2, "time_step must be from 1e-06 to 1e+06 s")


@pytest.mark.parametrize("name", ["positions", "car"])
@pytest.mark.parametrize("value", [1e160, -2e6])
def test_states_beyond_all_bounds_are_said_in_one_line(result, skd_here, name, value):
    """Squares of such numbers are infinite, which numpy says on the terminal."""

    def edit(values: np.ndarray) -> np.ndarray:
        values[len(values) // 2] = value
        return values

    change_arrays(result, **{name: edit})
    one_line(skd_here("show", str(result), "--out", "shown"), 2, "a state is not finite, or beyond ±1e+06")


# --- folders


@pytest.fixture
def closed() -> Iterator[Path]:
    """A folder with a folder in it that nobody may look into, for as long as the test is nobody."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        folder.chmod(0o755)
        (folder / "closed").mkdir(0o000)
        root = os.geteuid() == 0
        if root:
            os.seteuid(65534)
        try:
            yield folder
        finally:
            if root:
                os.seteuid(0)
            (folder / "closed").chmod(0o700)


def test_a_folder_that_nobody_may_look_into_is_not_left_out_without_a_word(closed):
    (run,) = find_runs([closed])
    assert (run.folder, run.remark) == (closed / "closed", "cannot be looked into (Permission denied)")
    for read in (folders_below, lambda folder: read_recordings([folder])):
        with pytest.raises(UsageError, match=r"closed: cannot be looked into \(Permission denied\)"):
            read(closed)


def test_a_result_that_is_a_link_to_nowhere_is_not_left_out_without_a_word(tmp_path):
    for name, leads in (("round", "assessment.json"), ("away", "nowhere")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "assessment.json").symlink_to(leads)
    found = [verify(folder) for folder in folders_below(tmp_path)]
    assert [(one.folder.name, one.fine) for one in found] == [("away", False), ("round", False)]
    assert all("assessment.json: cannot be read" in one.problems[0] for one in found)


def test_a_model_that_was_changed_where_it_was_written_is_refused(tmp_path):
    behaviour = tmp_path / "fitted" / "behaviour.yaml"
    behaviour.parent.mkdir()
    write_behaviour(behaviour, load_behaviour("walkers"))
    write_manifests(behaviour.parent)
    assert risk_asked(str(behaviour.parent)).behaviour == load_behaviour("walkers")
    text = behaviour.read_text()
    behaviour.write_text(text.replace("value: 0.3\n", "value: 0.0\n"))
    for source in (behaviour, behaviour.parent):
        with pytest.raises(UsageError, match=r"behaviour\.yaml: is not what was written: .* copy it to another folder"):
            risk_asked(str(source))
    shutil.copy(behaviour, tmp_path / "mine.yaml")
    assert risk_asked(str(tmp_path / "mine.yaml")).behaviour != load_behaviour("walkers")


# --- what takes more time or memory than it says, and names that nothing can have


def test_a_table_has_so_many_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(table, "_MOST", 100)
    (tmp_path / "x.csv").write_text("x,y\n" + "0,0\n" * 101)
    with pytest.raises(UsageError, match=r"x.csv, line 102: more than 100 rows"):
        table.read_table(tmp_path / "x.csv", {"x": 1.0})


def test_a_header_of_several_lines_is_said_in_one(tmp_path):
    (tmp_path / "x.csv").write_text('"a\nb",c\n1,2\n')
    with pytest.raises(UsageError, match="got a b,c"):
        table.read_table(tmp_path / "x.csv", {"x": 1.0})


@pytest.mark.parametrize("name", ["x" * 300, "~nobody-of-that-name/x"])
def test_a_campaign_names_a_scenario_that_cannot_be(tmp_path, name):
    (tmp_path / "x.yaml").write_text(f"encounters: [{{scenario: '{name}'}}]\n")
    with pytest.raises(UsageError, match=r"x.yaml"):
        read_campaign(tmp_path / "x.yaml")


@pytest.mark.parametrize("value", [".nan", ".inf", "[1]", "{a: 1}"])
@pytest.mark.parametrize("key", ["statistic", "p_value"])
def test_what_stands_beside_a_law_is_finite(tmp_path, key, value):
    """Episodes carry it as JSON, which has no such values."""
    car = replace(fitted_car(any_car_models()[0]), calibration=Calibration(100, 0.05, 0.5))
    model = yaml.safe_dump(yaml.safe_load(car_model_text(car)))
    path = tmp_path / "car_model.yaml"
    path.write_text(re.sub(rf"(calibration:(?:\n  .*)*\n  {key}: ).*", rf"\g<1>{value}", model))
    with pytest.raises(UsageError, match=f"calibration.{key} must be a finite number"):
        car_model_for_scenario(path, load_scenario("crossing"))
