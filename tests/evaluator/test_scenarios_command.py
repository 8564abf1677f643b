"""`skd scenarios`: names, pictures, files of one's own, campaigns of test speeds; and assessing on regulatory φ."""

import argparse
import json
import resource

import pytest
import yaml
from cli_support import names, one_line
from matplotlib.image import imread
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.cli.arguments import speeds
from skd_evaluator.extensions.campaign.cells import make_cells, read_campaign
from skd_sim import UsageError, load_scenario
from skd_sim.scenario.scenario_file import SCENARIOS

pytestmark = pytest.mark.usefixtures("pictures_drawn")
SCENARIO = "name: mine\ndescription: mine\nextends: cpna-75\ncar:\n  start_speed: 5.0\n"


def test_every_name_is_listed(skd_here):
    done = skd_here("scenarios", "list", "--json")
    assert done.returncode == 0, done.stderr
    listed = {one["name"]: one for one in json.loads(done.stdout)["scenarios"]}
    assert set(listed) == set(SCENARIOS.own)
    assert listed["cpna"]["impact_places"] == [0, 10, 25, 50, 75, 90, 100]
    assert all("Euro NCAP" in one["source"] for one in listed.values() if "regulatory" in one["safe"])
    assert listed["crossing"]["basic_margin"] == "exact"
    assert "not exact" in listed["cpna"]["basic_margin"]


def test_shown_ones_are_drawn(skd_here, here):
    done = skd_here("scenarios", "show", "cpnco-50", "ccftap", "cut_out", "--out", "shown")
    assert done.returncode == 0, done.stderr
    pictures = ["ccftap.png", "cpnco-50.png", "cut_out.png"]
    assert names(here / "shown") == [*pictures, "manifest.sha256", "scenarios.json"]
    assert all(imread(here / "shown" / name).shape[1] > 300 for name in pictures)
    assert "2 parked" in done.stdout
    assert skd_here("scenarios", "show", "cpna", "--out", "shown", "--overwrite").returncode == 0


def test_a_file_of_five_lines_is_checked(skd_here, here):
    (here / "mine.yaml").write_text(SCENARIO)
    done = skd_here("scenarios", "check", "mine.yaml", "--out", "checked", "--json")
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)["scenarios"]
    assert (found["car_speed"], found["impact_places"], found["picture"]) == (5.0, [75.0], "mine.png")
    for text, said in (
        ("adversary:\n  kind: unicorn\n", "unicorn"),
        ("adversary:\n  start_x: 0.5\n", "cannot be at 75 %"),
        ("obstacles:\n  - {x: 3.0, y: 0.0, heading: 0.0, length: 1.0, width: 1.0}\n", "runs into obstacles"),
        ("car:\n  start_sped: 3.0\n", "start_sped"),
    ):
        (here / "bad.yaml").write_text(f"name: bad\ndescription: bad\nextends: cpna-75\n{text}")
        one_line(skd_here("scenarios", "check", "bad.yaml", "--out", "bad"), 2, said)
        assert not (here / "bad").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("show",), "needs a name"),
        (("check",), "needs a file"),
        (("list", "cpna"), "takes no names"),
        (("crossing",), "did you mean skd scenarios show crossing?"),
        (("show", "cpna", "--speeds", "10:20:10"), "goes with skd scenarios campaign"),
        (("campaign", "cpna"), "needs --speeds"),
        (("campaign", "crossing", "--speeds", "10:20:10"), "has no section protocol"),
        (("show", "cpna-33"), "impact places are 0, 10, 25"),
        (("show", "cpna", "cpna"), "have one name"),
    ],
)
def test_what_is_not_there_is_said_in_one_line(skd_here, words, said):
    one_line(skd_here("scenarios", *words), 2, said)


@pytest.mark.parametrize("text", ["10", "10:60", "60:10:10", "10:60:0", "a:b:c", "0:60:10", "1:60:0.1", "10:inf:1"])
def test_speeds_that_are_none_are_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match="must be FROM:TO:STEP"):
        speeds(text)


def test_a_campaign_of_test_speeds(skd_here, here):
    done = skd_here("scenarios", "campaign", "cpna", "cbfa-50", "--speeds", "10:60:10", "--out", "grid.yaml")
    assert done.returncode == 0, done.stderr
    assert yaml.safe_load((here / "grid.yaml").read_text())["defaults"]["safe"] == "regulatory"
    cells = make_cells(read_campaign(here / "grid.yaml"))
    assert len(cells) == 12
    for cell in cells:
        car = cell.plan.scenario.car
        assert car.start_gap == pytest.approx(4.5 * car.start_speed)
        assert cell.plan.safe_count == (7 if cell.plan.scenario.name == "cpna" else 1)
    assert {round(3.6 * cell.plan.scenario.car.start_speed) for cell in cells} == {10, 20, 30, 40, 50, 60}
    again = skd_here("scenarios", "campaign", "cpna", "--speeds", "10:20:10", "--out", "grid.yaml")
    one_line(again, 2, "is there already")


def test_as_many_as_are_asked_for():
    scenario = load_scenario("cpna")
    found = safe_trajectories(Plan(scenario, safe="regulatory", safe_count=3), InProcessRunner(1))
    assert [one.name for one in found] == ["regulatory/0", "regulatory/50", "regulatory/100"]
    with pytest.raises(UsageError, match="7 usable safe trajectories where 8 were requested"):
        safe_trajectories(Plan(scenario, safe="regulatory", safe_count=8), InProcessRunner(1))
    with pytest.raises(UsageError, match="scenario crossing has no section protocol"):
        safe_trajectories(Plan(load_scenario("crossing"), safe="regulatory", safe_count=1), InProcessRunner(1))


@pytest.mark.parametrize("there", ["old", None])
def test_a_full_disk_leaves_what_was_there(there, skd_here, here) -> None:
    """The file had no byte left of the old one, nor of the new one."""
    (here / "place").mkdir()
    if there is not None:
        (here / "place" / "c.yaml").write_text(there)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        words = ("campaign", "cpna", "--speeds", "20:20:10", "--out", "place/c.yaml", "--overwrite")
        done = skd_here("scenarios", *words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    one_line(done, 1, "--out place/c.yaml: nothing was written: File too large")
    assert names(here / "place") == ([] if there is None else ["c.yaml"])
    assert there is None or (here / "place" / "c.yaml").read_text() == there


@pytest.mark.parametrize("name", ["cpna #2.yaml", "a: b.yaml", "two\nlines.yaml", "*a"])
def test_a_campaign_is_of_the_file_that_was_named(name, skd_here, here) -> None:
    """Of `cpna #2.yaml` YAML read `cpna`: SKD's own scenario was rated, and nobody was told."""
    (here / name).write_text(SCENARIO)
    done = skd_here("scenarios", "campaign", name, "cpna", "--speeds", "20:30:10", "--out", "c.yaml")
    assert done.returncode == 0, done.stderr
    text = (here / "c.yaml").read_text(encoding="utf-8")
    assert yaml.safe_load(text)["scenarios"] == [{"scenario": name}, {"scenario": "cpna"}]
    assert [line for line in text.splitlines() if line.startswith("#")] == text.splitlines()[:1]
    assert "  - scenario: cpna\n" in text  # which needs no marks
    cells = make_cells(read_campaign(here / "c.yaml"))
    assert [one.plan.scenario.name for one in cells] == ["mine", "mine", "cpna", "cpna"]
