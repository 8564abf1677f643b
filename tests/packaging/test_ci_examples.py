"""The action rates a car as a workflow would, and the examples for continuous integration name only what exists."""

import json
import os
import re
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
import yaml
from common import run_program
from packaging_support import ROOT
from skd_evaluator.assessment.files.assessment_json import check_figure
from skd_evaluator.cli.main import make_parser, parse
from skd_evaluator.cli.revisions import assess_request

ACTION = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
STEPS = {step.get("name", step.get("uses")): step for step in ACTION["runs"]["steps"]}
FOLDER = ROOT / "examples" / "ci"
CAR = """
class Car:
    def reset(self, scenario, rng): pass
    def command(self, car, adversary): return 0.0
"""


def rate(folder: Path, **inputs: str) -> tuple[subprocess.CompletedProcess[str], dict[str, Path]]:
    """Run the step that rates as GitHub does, and return its outputs."""
    given = {name: one["default"] for name, one in ACTION["inputs"].items()} | inputs
    texts = {f"inputs.{name}": text for name, text in given.items()} | {"runner.temp": str(folder)}
    environment = {
        name: re.sub(r"\$\{\{ ([\w.]+) \}\}", lambda found: texts[found[1]], text)
        for name, text in STEPS["Rate"]["env"].items()
    }
    environment |= {"ROS_DISTRO": "", "RUNNER_TEMP": str(folder), "GITHUB_ACTION_PATH": str(ROOT)}
    environment |= {name: str(folder / name) for name in ("GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY")}
    environment["SKD_CACHE_DIR"] = os.environ.get("SKD_CACHE_DIR", str(Path.home() / ".cache" / "skd"))
    if not (folder / "skd").exists():
        (folder / "skd").symlink_to(sys.prefix)
    done = run_program("bash", "-e", "-o", "pipefail", "-c", STEPS["Rate"]["run"], cwd=folder, **environment)
    lines = (folder / "GITHUB_OUTPUT").read_text(encoding="utf-8").splitlines()
    return done, {name: folder / path for name, path in (line.split("=", 1) for line in lines)}


def test_the_action_rates_a_class_and_fails_by_its_gate(tmp_path):
    """With all outputs that it promises, also where it fails."""
    (tmp_path / "my_car.py").write_text(CAR)
    few = "--safe-count 1 --kamikaze-count 1 --collision-runs 1 --adversary-model generic --margin-limit 1 --seed '0'"
    few += " --behaviour none --no-pictures"
    done, outputs = rate(tmp_path, controller="my_car:Car", gate="--fail-above skd=0.01", options=few, out="result")
    assert done.returncode == 1, done.stderr
    assert set(outputs) == set(ACTION["outputs"])
    figures = json.loads((outputs["result"] / "assessment.json").read_text(encoding="utf-8"))
    failures = ElementTree.parse(outputs["junit"]).findall(".//failure")
    assert len(failures) == 1
    assert outputs["page"].read_text(encoding="utf-8") == (tmp_path / "GITHUB_STEP_SUMMARY").read_text(encoding="utf-8")
    badge = json.loads(outputs["badge"].read_text(encoding="utf-8"))
    assert (badge["message"], badge["color"]) == (f"{figures['margin']:.2f} m", "red")


def test_the_action_says_where_nothing_was_rated(tmp_path):
    done, outputs = rate(tmp_path, controller="nowhere:Car", gate="--fail-below margin=0.1")
    assert done.returncode == 2
    assert json.loads(outputs["badge"].read_text(encoding="utf-8"))["message"] == "not rated"


def test_the_action_installs_what_it_comes_with():
    words = shlex.split(STEPS["Install"]["run"], comments=True)
    assert "$GITHUB_ACTION_PATH" in words
    assert "clone" not in words
    for output in ACTION["outputs"].values():
        (name,) = re.findall(r"steps\.rate\.outputs\.(\w+)", output["value"])
        assert f'"{name}=' in STEPS["Rate"]["run"]


def gates() -> dict[str, list[str]]:
    """The words that the examples give to `skd assess`."""
    github: dict[str, Any] = yaml.safe_load((FOLDER / "github-actions.yml").read_text(encoding="utf-8"))
    (step,) = [step for step in github["jobs"]["rating"]["steps"] if step.get("id") == "skd"]
    assert set(step["with"]) <= set(ACTION["inputs"])
    given = step["with"]
    (upload,) = [step for step in github["jobs"]["rating"]["steps"] if "upload-artifact" in step.get("uses", "")]
    assert set(re.findall(r"outputs\.(\w+)", upload["with"]["path"])) == set(ACTION["outputs"])
    gitlab = yaml.safe_load((FOLDER / "gitlab-ci.yml").read_text(encoding="utf-8"))["skd"]
    (line,) = [line for line in gitlab["script"] if line.startswith("skd ")]
    assert set(gitlab["artifacts"]["paths"]) == {"skd-result", "skd.xml", "skd.md"}
    return {
        "GitHub": shlex.split(f"assess --controller {given['controller']} {given['gate']} {given['options']}"),
        "GitLab": shlex.split(line)[1:],
    }


@pytest.mark.parametrize("place", ["GitHub", "GitLab"])
def test_conditions_are_ones_that_there_are(place):
    parsed = make_parser().parse_args(gates()[place])
    for figure, _ in (*parsed.fail_below, *parsed.fail_above):
        check_figure(figure)
    assert parsed.fail_if_worse_than is not None


def test_the_nightly_job_bisects_with_options_that_there_are():
    steps = yaml.safe_load((FOLDER / "github-nightly.yml").read_text(encoding="utf-8"))["jobs"]["night"]["steps"]
    (rating,) = [step["with"] for step in steps if "skd@" in step.get("uses", "")]
    assert set(rating) <= set(ACTION["inputs"])
    text = " ".join(step.get("run", "") for step in steps)
    last = dict(re.findall(r'"(gate|options)=([^"]+)"', text))
    words = ["assess", *last["gate"].split(), *last["options"].split()]
    assert make_parser().parse_args(words).warm_start == "skd-last"
    (line,) = [step["run"] for step in steps if " bisect " in step.get("run", "")]
    words = re.sub(r"\$\{\{[^}]+\}\}", "0123abc", line).split()
    parsed = parse(make_parser(), words[1:])
    assert (parsed.good, parsed.bad) == ("0123abc", "HEAD")
    assert assess_request(parsed.words).controller == rating["controller"]
