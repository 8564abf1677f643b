"""Single files that a user names: what is no file is never replaced, a link leads on, and nothing is half-written."""

import resource
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from cli_support import SMALL, names, one_line
from skd_evaluator.extensions.campaign.cells import make_cells, read_campaign

Run = Callable[..., subprocess.CompletedProcess[str]]
SCENARIO = "name: mine\ndescription: mine\nextends: cpna-75\ncar:\n  start_speed: 5.0\n"


def test_a_gate_writes_over_nothing_that_the_command_reads(skd_here: Run, here: Path) -> None:
    (here / "mine.yaml").write_text(SCENARIO)
    (here / "link").symlink_to("mine.yaml")
    for name in ("mine.yaml", "link"):
        done = skd_here("assess", *SMALL, "--scenario", "mine.yaml", "--markdown", name, "--out", "out")
        one_line(done, 2, f"--markdown {name}: is read by this command; give another file")
        campaign = ("scenarios", "campaign", "mine.yaml", "--speeds", "20:20:10", "--overwrite", "--out", name)
        one_line(skd_here(*campaign), 2, f"--out {name}: is read by this command; give another file")
    assert (here / "mine.yaml").read_text() == SCENARIO
    assert not (here / "out").exists()


@pytest.mark.parametrize("there", ["old", None])
def test_a_full_disk_leaves_what_was_there(there: str | None, skd_here: Run, here: Path) -> None:
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


ODD = ["cpna #2.yaml", "a: b.yaml", "two\nlines.yaml", "*a"]


@pytest.mark.parametrize("name", ODD)
def test_a_campaign_is_of_the_file_that_was_named(name: str, skd_here: Run, here: Path) -> None:
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
