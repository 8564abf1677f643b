"""What others wrote: files that never begin or end, values where they cannot be."""

import shutil
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from cli_support import one_line
from report_support import edit
from skd_evaluator.assessment.files.result_folder import write_manifests
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.metrics.behaviour.model import load_behaviour, write_behaviour
from skd_sim.errors import UsageError

pytestmark = pytest.mark.usefixtures("pictures_drawn")


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
    edit(result, FORGED[name])
    words = {
        "report": ["report", result, "--out", "r.html"],
        "compare": ["compare", sweep / "synthetic" / "C_0.5", result, "--out", "compared"],
    }[command]
    one_line(skd_here(*map(str, words)), 2, "assessment.json")


@pytest.mark.parametrize(
    ("name", "place", "value", "said"),
    [
        ("impact_speed", slice(None), np.nan, "episodes.npz: a collision has no impact speed"),
        ("positions", 40, np.nan, "a state is not finite"),
        ("safe_index", -1, 9, "a φ that is not there"),
    ],
)
def test_arrays_that_cannot_be_are_said_in_one_line(result, skd_here, name, place, value, said):
    with np.load(result / "episodes.npz") as file:
        arrays = dict(file)
    arrays[name][place] = value
    np.savez(result / "episodes.npz", **arrays)
    write_manifests(result)
    one_line(skd_here("report", str(result), "--format", "png", "--out", "shown"), 2, said)


def test_a_model_that_was_changed_where_it_was_written_is_refused(tmp_path):
    behaviour = tmp_path / "fitted" / "behaviour.yaml"
    behaviour.parent.mkdir()
    write_behaviour(behaviour, load_behaviour("walkers"))
    write_manifests(behaviour.parent)
    assert risk_request(str(behaviour.parent)).behaviour == load_behaviour("walkers")
    text = behaviour.read_text()
    behaviour.write_text(text.replace("value: 0.3\n", "value: 0.0\n"))
    for source in (behaviour, behaviour.parent):
        with pytest.raises(UsageError, match=r"behaviour\.yaml: is not what was written"):
            risk_request(str(source))
    shutil.copy(behaviour, tmp_path / "mine.yaml")
    assert risk_request(str(tmp_path / "mine.yaml")).behaviour != load_behaviour("walkers")
