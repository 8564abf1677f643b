"""Figures that stay as they are, to the last bit, however the code is arranged: of whole assessments, each way to run.

`goldens.json` has those of each case; `searched.json` has those that follow from the search for the margin. They hold
for one kind of machine: another processor, mathematical library or release of numba may round otherwise. A change that
means to change figures writes both anew, and says what changes: `python tests/goldens/test_goldens.py --write`.
"""

import json
import os
import sys
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skd_evaluator

HERE = Path(__file__).resolve().parent
GOLDENS, SEARCHED = HERE / "goldens.json", HERE / "searched.json"
TRACKS = "tracks"  # stands for a folder that is written first

SMALL = {"safe_count": 2, "kamikaze_count": 2, "collision_runs": 8, "margin_limit": 64, "seed": 3}
CASES: dict[str, dict[str, Any]] = {
    "basic, C = 0.5": {"multiplier": 0.5},
    "basic, C = 1": {},
    "basic, C = 1.15": {"multiplier": 1.15, "curve": True},
    "basic, recorded φ": {"safe": TRACKS, "multiplier": 1.15},
    "basic, cyclist": {"scenario": "cyclist", "multiplier": 0.75},
    "CAL": {"controller": "cal", "adversary_model": "generic", "kamikaze_count": 1, "margin_limit": 16},
    "class with state": {"controller": "latched_car:LatchedCar", "safe": "own", "adversary_model": "generic"},
}
EXACT = {name for name in CASES if name.startswith("basic, ") and "cyclist" not in name}
"""Cases whose margin is computed, not searched."""
RUNS = [
    *((name, way) for name in CASES for way in ("1 worker", "2 workers")),
    *(("basic, C = 1", way) for way in ("composed", "separate")),
    ("class with state", "composed"),
]


def same(names: str) -> dict[str, str]:
    return {name: name for name in names.split()}


OF_THE_MARGIN = {
    **same("margin margin_ci95 margin_p10"),
    "margin_impact_speed": "impact_speed",
    "margin_curve": "vulnerability_curve.margins.area_above",
    **same("optimality_gap optimality_gap_ci95 equivalent_multiplier equivalent_multiplier_ci95"),
}
OF_THE_RISK = same(" ".join(f"risk_{scale} risk_{scale}_ci95_runs risk_{scale}_ci95" for scale in (1, 2, 3)))
OTHERS = {
    **same("deviation deviation_ci95 deviation_ci95_trials deviation_success_rate deviation_success_rate_ci95"),
    "deviation_planned_for_the_paper": "objectives.paper.deviation",
    **same("skd skd_ci95 skd_ci95_pairs skd_prefix skd_prefix_ci95"),
    "skd_planned_for_deviation": "objectives.deviation.skd",
    "skd_variance": "variance",
    **same("probability_bound probability_bound_ci95"),
    "warped": "measures.warped.mean",
    "required_deceleration_at_entry": "measures.required_deceleration_at_entry.mean",
    **same("kamikaze_success_rate kamikaze_success_rate_ci95 mean_impact_speed mean_closing_speed"),
    **same("contact_rate contact_rate_ci95 nominal_collision_rate nominal_collision_rate_ci95 aborted pairs"),
    "time_to_collision_along_phi": "surrogate_measures.along_phi.time_to_collision",
    "clearance_along_phi": "surrogate_measures.along_phi.clearance",
    "delta_v_of_kamikazes": "surrogate_measures.kamikazes.paper.delta_v",
    "curve": "vulnerability_curve.kamikazes.area_above",
    "curve_budgets": "vulnerability_curve.budgets",
}
FIGURES = {**OF_THE_MARGIN, **OF_THE_RISK, **OTHERS}
"""Where each figure stands in assessment.json. One whose key is renamed is renamed here alone."""


def hexadecimal(value: Any) -> Any:
    """Return a figure with each number as its hexadecimal form, which no rounding makes equal to another."""
    if isinstance(value, Mapping):
        return {key: hexadecimal(one) for key, one in value.items()}
    if isinstance(value, list):
        return [hexadecimal(one) for one in value]
    return value.hex() if isinstance(value, float) else value


def figures(folder: Path) -> dict[str, Any]:
    found = {}
    for name, place in FIGURES.items():
        value = json.loads((folder / "assessment.json").read_text(encoding="utf-8"))
        for key in place.split("."):
            value = value[key]
        found[name] = hexadecimal(value)
    return found


def write_tracks(folder: Path) -> None:
    """Write two walks as if they were recorded: each at a pace of its own, swaying, at a camera's rate."""
    folder.mkdir()
    for name, pace, sway in (("a", 1.37, 0.2), ("b", 1.12, -0.1)):
        seconds = np.arange(0.0, 7.0, 1.0 / 29.97)
        x = -4.1 + pace * seconds
        rows = np.column_stack([seconds, x, 0.12 * x + sway * np.sin(1.3 * x)]).tolist()
        lines = "".join(f"{t!r},{x!r},{y!r}\n" for t, x, y in rows)
        (folder / f"{name}.csv").write_text("t,x,y\n" + lines, encoding="utf-8")


def options_of(name: str, folder: Path) -> dict[str, Any]:
    """Return all options of a case; its tracks are written into a folder."""
    options = SMALL | CASES[name]
    if options.get("safe") == TRACKS:
        options["safe"] = str(folder / TRACKS)
        write_tracks(folder / TRACKS)
    return options


def skd(*words: object) -> None:
    """Run a command in a process of its own, and in a domain of its own."""
    from common import PATIENCE, new_domain  # which `--write` does not need, and could not import
    from forked_skd import ForkedSkd

    variables = os.environ | {"PYTHONPATH": str(HERE), "ROS_DOMAIN_ID": str(new_domain())}
    variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    done = ForkedSkd([*map(str, words)], cwd=Path.cwd(), environment=variables).finish(PATIENCE)
    assert done.returncode == 0, done.stderr


def result_of(name: str, way: str, folder: Path) -> Path:
    """Assess a case in one of the ways, and return the result's folder."""
    options, out = options_of(name, folder), folder / "result"
    if "worker" in way:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # few φ, and a search that is cut short
            skd_evaluator.assess(**options, workers=int(way[0]), out=out)
        return out
    words = [f"--{key.replace('_', '-')}={value}" for key, value in options.items()]
    skd("assess", "--graph", "--record", "-p", f"nodes:={way}", "--no-pictures", *words, "--out", out)
    return out


@pytest.mark.parametrize(("name", "way"), RUNS)
def test_figures_are_what_they_were(tmp_path: Path, name: str, way: str) -> None:
    golden = json.loads(GOLDENS.read_text(encoding="utf-8"))[name]
    golden |= json.loads(SEARCHED.read_text(encoding="utf-8")).get(name, {})
    result = result_of(name, way, tmp_path)
    assert figures(result) == golden
    if way == "composed" and name in EXACT:  # a replay searches no margin
        skd("replay", result / "bags", "--out", tmp_path / "replayed")
        replayed = figures(tmp_path / "replayed")
        assert {key for key, value in replayed.items() if value != golden[key]} == set(OF_THE_RISK)  # it has no walkers


def write() -> None:
    goldens, searched = {}, {}
    for name in CASES:
        with tempfile.TemporaryDirectory() as folder:
            found = figures(result_of(name, "1 worker", Path(folder)))
        if name not in EXACT:
            searched[name] = {key: found.pop(key) for key in OF_THE_MARGIN}
        goldens[name] = found
    for path, cases in ((GOLDENS, goldens), (SEARCHED, searched)):
        lines = []
        for name, found in cases.items():
            rows = ",\n".join(f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in found.items())
            lines.append(f" {json.dumps(name, ensure_ascii=False)}: {{\n{rows}\n }}")
        path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit("usage: python tests/goldens/test_goldens.py --write")
    write()
