"""From episodes.npz and docs/files.md alone: scripts of one page each give every figure of assessment.json again."""

import contextlib
import io
import json
import math
import re
import runpy
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skd_evaluator.assessment.context import Context
from skd_evaluator.assessment.files.results import write_assessment
from skd_evaluator.assessment.files.verification import verify
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.episodes import aborted
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages import kamikazes
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_sim import EpisodeLog, EpisodeSpec, Mode, Outcome, Trajectory, load_scenario
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES
from skd_sim.world.episode import AbortKind, abort_reason, kind_of
from stages import rate, with_margins, with_risks

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "examples" / "recompute"
FILES = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
PLAN = Plan(
    load_scenario("crossing"), multiplier=1.15, safe_count=2, kamikaze_count=8, collision_runs=12, seed=3,
    simulations=30,
)  # fmt: skip
NOT_RECOMPUTED = {
    r"seconds|seed|multiplier|simulations|maximum_distance|(.*\.)?eta_max": "what was asked for, or the clock's",
    r"margin_budget|distinct_safe_trajectories": "how the margin was sought; null where it is exact",
    r"equivalent_multiplier.*": "read off margins of basic cars, which are in no file of this one",
    r"(provenance|scenario|options)\..*|command_age.*|until_width.*": "how it was run, and what the graph alone has",
    r"(.*\.)?measures\.warped\.(undefined|error|pairs)": "of measures that may fail; this one does not",
    r"vulnerability_curve\.budgets\..*": "kamikazes held to η are episodes of their own, and not in the file",
    r"(.*\.)?clustering\..*\.notes": "words",
    r"risk\.behaviour\..*": "the behaviour model that was asked for",
    r"risk\.failures\.kinds\..*": "of walkers that are drawn anew from the seed: test_risk.py",
    r"vulnerability_curve": "null where no curve was asked for",
}  # fmt: skip


OF_THE_CAR = (
    "objectives.", "collision_", "contact_rate", "clustering.contact_rate", "vulnerability", "margin", "optimality_gap",
    "nominal_collision_rate", "impact_speed", "risk", "surrogate_measures",
)  # fmt: skip
"""Figures that are of no objective."""


class SometimesAborts:
    """A runner of which every fifth episode is lost, on its way or before it began: then no state of it is known."""

    def __init__(self, runner: InProcessRunner) -> None:
        self._runner = runner
        self._count = 0

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        for log in self._runner.run(episodes):
            self._count += 1
            lost = abort_reason((AbortKind.ENDED, AbortKind.NO_ANSWER)[self._count % 2], "as a test wants it")
            if self._count % 10 == 0:
                yield aborted(log.episode, lost)
            elif self._count % 5 == 0:
                never = {"impact_time": math.nan, "impact_speed": math.nan}
                yield replace(log, outcome=Outcome.ABORTED, reason=lost, **never)
            else:
                yield replace(log, clipped=self._count % 3)


@pytest.fixture(scope="module")
def safe() -> list[Trajectory]:
    return safe_trajectories(PLAN, InProcessRunner(1))


@pytest.fixture(scope="module", params=[None, 2.0], ids=["all", "near"])
def results(request: pytest.FixtureRequest, safe, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    with InProcessRunner(1) as runner:
        plan = replace(PLAN, maximum_distance=request.param)
        rating = rate(plan, DEFAULT_OBJECTIVES, safe, SometimesAborts(runner))
        rating = with_margins(rating, runner, 300)
        runs = None if request.param is None else 2000  # without subset simulation, and with it
        rating = with_risks(rating, risk_request("walkers", runs), runner)
        rating = kamikazes.run_bounded(Context(runner, runner, curve=True), rating)
    write_assessment(folder, rating)
    return folder


def leaves(content: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every number, pair of numbers and null in JSON, by its dotted name."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from leaves(value, f"{name}.{key}" if name else key)
    elif isinstance(content, list) and content and isinstance(content[0], dict):
        for index, value in enumerate(content):
            yield from leaves(value, f"{name}.{index}")
    elif not isinstance(content, (str, bool)) and content != []:
        yield name, content


def its_name(figure: str) -> str:
    """What the scripts call a figure of assessment.json."""
    named = re.sub(r"measures\.warped\.mean$", "warped", figure)
    named = re.sub(r"measures\.warped\.(ci95\w*)$", r"warped_\1", named)
    named = re.sub(r"probability_bound(_ci95)?\.([\d.]+)$", r"bound_\2\1", named)
    return re.sub(r"collision_runs$", "runs", named)


def its_source(figure: str, said: dict[str, Any]) -> str:
    """Where a figure at the top is from; the name itself for every other."""
    if figure.startswith(OF_THE_CAR):
        return figure
    within = re.sub(r"^clustering\.", "", figure)
    for head, objective in (("deviation_success_rate", "deviation"), ("kamikaze_", "paper")):
        if within.startswith(head):
            rest = within.removeprefix(head if head.endswith("_") else "deviation_")
            return f"objectives.{objective}.{'clustering.' * (within != figure)}{rest}"
    objective = "deviation" if within.startswith(("deviation", "measures")) else "paper"
    if match := re.match(r"per_safe_trajectory\.\d+\.(\w+)$", figure):
        if match[1].startswith(("collision", "contact_rate")):
            return figure
        objective = "deviation" if match[1].startswith("deviation") else "paper"
    return f"objectives.{objective}.{figure}"


@pytest.fixture(scope="module")
def recomputed(results):
    """Every figure that the scripts give, by name, run in the folder as their first lines say."""
    found: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as said:
        patch.chdir(results)
        patch.syspath_prepend(str(SCRIPTS))
        for name, variable, prefix in (
            ("recompute", "found", ""),
            ("by_phi", "by_phi", ""),
            ("braking", "braking", ""),
            ("curve", "curve", "vulnerability_curve."),
            ("margins", "margin", ""),
            ("risk", "risk", ""),
            ("surrogate", "surrogate", ""),
        ):
            entries = runpy.run_path(str(SCRIPTS / f"{name}.py"))[variable]
            found |= {f"{prefix}{key}": value for key, value in entries.items()}
        for name in ("coupling", "intervals", "bounds", "by_phi", "margins", "recompute", "touching"):
            sys.modules.pop(name, None)
    assert all(f"\n{name}: " in f"\n{said.getvalue()}" for name in found)
    return found


def test_the_scripts_give_every_figure(results, recomputed):
    said = json.loads((results / "assessment.json").read_text(encoding="utf-8"))
    compared = set()
    for name, value in leaves(said):
        if any(re.fullmatch(pattern, name) for pattern in NOT_RECOMPUTED):
            continue
        if name == "aborted" or name.startswith(("aborted_reasons", "commands_clipped")):
            continue  # below
        source = its_source(name, said)
        again = recomputed.get(its_name(source), math.nan)
        if re.search(r"per_safe_trajectory\.\d+\.trials$", name):
            again += recomputed[its_name(source).replace("trials", "aborted")]
        if value is None or value == [None, None]:
            assert np.isnan(np.asarray(again, float)).all(), name
        else:
            assert again == pytest.approx(value, rel=1e-8, abs=1e-10), name
            compared.add(re.sub(r"\.\d+\.", ".", name))
    assert len(compared) > 300


def test_verify_finds_the_same(results):
    assert verify(results).fine


def test_the_columns_give_what_is_counted(results):
    said = json.loads((results / "assessment.json").read_text(encoding="utf-8"))
    arrays = np.load(results / "episodes.npz")
    reasons = [str(reason) for reason in arrays["reason"] if reason]
    assert said["aborted"] == len(reasons) == (arrays["outcome"] == Outcome.ABORTED).sum() > 4
    counts = {kind: entry["count"] for kind, entry in said["aborted_reasons"].items()}
    assert counts == {str(kind): sum(kind_of(one) == kind for one in reasons) for kind in set(map(kind_of, reasons))}
    clipped = arrays["clipped"]
    assert said["commands_clipped"] == {"commands": clipped.sum(), "episodes": (clipped > 0).sum()}
    assert [row["name"] for row in said["per_safe_trajectory"]] == arrays["safe_name"].tolist()
    assert (said["seed"], said["eta_max"]) == (arrays["seed"], arrays["eta_max"])


def test_every_array_and_code_is_described(results):
    table = FILES[FILES.index("## episodes.npz") : FILES.index("## surrogate_measures.csv")]
    arrays = np.load(results / "episodes.npz")
    assert not set(arrays) - set(re.findall(r"`(\w+)`", table))
    for rows in re.findall(r"^\*\*For each [^|]*\| array .*?\n.*?\n(.*?)\n\n", table, re.MULTILINE | re.DOTALL):
        named = re.findall(r"`(\w+)`", "".join(line.split(" | ")[0] for line in rows.splitlines()))
        lengths = {name: len(arrays[name]) for name in named if name in arrays}
        assert len(lengths) > 3, named
        assert len(set(lengths.values())) == 1, lengths
    for codes in (Mode, Outcome):
        for one in codes:
            if one != Outcome.RUNNING:
                assert re.search(rf"\b{int(one)} = `{one.name.lower()}`", table), one
    for script in SCRIPTS.glob("*.py"):
        assert len(script.read_text(encoding="utf-8").splitlines()) <= 40, script
