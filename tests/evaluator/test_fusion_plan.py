"""How many physical trials a width takes: against intervals of drawn trials, and what the command says."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from common import run_skd
from scipy import stats
from skd_evaluator.extensions.fusion.estimate import fitted_line, trials_for_width, width_alone, width_fused


@pytest.mark.parametrize(("rho", "trials"), [(0.5, 10), (0.8, 10), (0.9, 20)])
def test_expected_widths_are_those_of_drawn_trials(rho, trials):
    rng, widths = np.random.default_rng(trials), []
    for _ in range(2000):
        x, other = rng.standard_normal((2, trials))
        y, centre = rho * x + math.sqrt(1.0 - rho**2) * other, rng.standard_normal() / math.sqrt(500.0)
        line = fitted_line(y, x)
        squared = (
            line.residual * (1.0 / trials + (centre - x.mean()) ** 2 / line.spread) + (line.slope or 0.0) ** 2 / 500
        )
        widths.append(
            (
                2.0 * stats.t.ppf(0.975, trials - 1) * stats.sem(y),
                2.0 * stats.t.ppf(0.975, trials - 2) * math.sqrt(squared),
            )
        )
    alone, both = np.mean(widths, axis=0)
    assert width_alone(trials, 1.0) == pytest.approx(alone, rel=0.02)
    assert width_fused(trials, 1.0, rho, 500) == pytest.approx(both, rel=0.03)


def test_the_least_number_of_trials():
    for width in (0.5, 1.0):
        alone = trials_for_width(width, 1.0)
        both = trials_for_width(width, 1.0, 0.9, 5000)
        assert alone is not None
        assert both is not None
        assert width_alone(alone, 1.0) <= width < width_alone(alone - 1, 1.0)
        assert both < alone / 2
    assert trials_for_width(0.01, 1.0, 0.9, 50) is None  # what 50 simulated φ leave open is wider
    assert trials_for_width(9.0, 1.0) == 5


PLAN = ("fuse", "--figure", "clearance", "--width", "0.1")


@pytest.fixture(scope="module")
def fused(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, rng = tmp_path_factory.mktemp("plan"), np.random.default_rng(0)
    values = 1.0 + rng.random(400)
    rows = [f"w{index},{value}" for index, value in enumerate(values)]
    real = [f"w{index},{value - 0.3 + 0.1 * rng.standard_normal()}" for index, value in enumerate(values[:10])]
    for name, lines in (("simulated.csv", rows), ("real.csv", real)):
        (folder / name).write_text("\n".join(["phi,clearance", *lines]), encoding="utf-8")
    words = (folder / "simulated.csv", folder / "real.csv", "--out", folder / "fused", "--quiet")
    assert run_skd("fuse", *words) == 0
    return folder / "fused"


def test_the_command_plans_with_what_was_fused(fused: Path, capsys: pytest.CaptureFixture[str]):
    words = (*PLAN, fused)
    assert run_skd(*words, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    found = json.loads((fused / "fusion.json").read_text("utf-8"))["figures"]["clearance"]
    assert said["deviation"] == pytest.approx(found["deviation"])
    assert said["correlation"] == pytest.approx(found["correlation"])
    known = next(row for row in said["with_simulator"] if row["correlation"] == said["correlation"])
    assert known["trials"] == trials_for_width(0.1, said["deviation"], said["correlation"], 400)
    assert said["physical_alone"] > 2 * known["trials"]
    assert run_skd(*words, "--correlation", "0.6") == 0
    assert "where ρ = 0.60" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("FUSED",), "give PHYSICAL, the table of trials, or --width"),
        (("--width", "0.1", "FUSED"), "has no margin of skd fuse"),
    ],
)
def test_plans_that_cannot_be(fused: Path, capsys: pytest.CaptureFixture[str], words, says):
    assert run_skd("fuse", *(fused if word == "FUSED" else word for word in words)) == 2
    assert says in capsys.readouterr().err
