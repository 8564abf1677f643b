"""Input of a command: what stays as it was, and what is refused."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from cli_support import CONTROLLERS, CROSSING, SMALL, edited, one_line, skd
from common import run_skd
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.main import make_parser
from skd_sim.errors import UsageError


@pytest.mark.parametrize(
    ("option", "content", "parts"),
    [
        ("--safe=phi.csv", None, ["no such file"]),
        ("--safe=phi.csv", "t,x,y\n0,-3,0\n0.3,-2,0\noops,-1,0\n", ["line 4", "t must be a number", "'oops'"]),
        ("--scenario=scenario.yaml", None, ["skd scenarios lists all"]),
        ("--scenario=scenario.yaml", edited(car__wings=2), ["unknown key car.wings"]),
    ],
)
def test_bad_file(here, skd_here, option, content, parts):
    file = option.partition("=")[2]
    if content is not None:
        (here / file).write_text(content)
    one_line(skd_here("assess", *SMALL, option, "--out", "out"), 2, file, *parts)
    assert not (here / "out").exists()


def test_sweep_reads_recorded_trajectories_before_it_runs_anything(here):
    """Or it would not end in time."""
    one_line(skd("sweep", "--safe", "missing.csv", "--simulations", "100000", cwd=here), 2, "missing.csv")


WHOLE = ["--safe-count", "--kamikaze-count", "--collision-runs", "--simulations", "--workers", "--seed"]


@pytest.mark.parametrize(
    ("option", "value"),
    [(option, value) for option in WHOLE for value in ("-1", "1.5", "nan")]
    + [(option, "0") for option in WHOLE if option != "--seed"],
)
def test_bad_number(capsys, option, value):
    assert run_skd("assess", f"{option}={value}") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert option in line
    assert repr(value) in line


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["compare", "x", "--width=0"], "argument --width: must be a finite number > 0, got '0'"),
        (["assess", "--max-aborted=101"], "must be a finite number ≤ 100"),
        (["fuse", "a", "b", "--frame=1,0"], "argument --frame: must be X,Y,DEGREES"),
        (["protocol", "ncap", "--speeds=20:10:10"], "argument --speeds: must be FROM:TO:STEP"),
        (["assess", "--behaviour", "none", "-p", "risk_runs:=50"], "risk_runs 50: --behaviour none asks for no risk"),
        (["sweep", "--behaviour", "none", "-p", "risk_subset:=true"], "risk_subset: --behaviour none asks for no risk"),
        (["assess", "-p", "maximum_distance:=-1"], "-p maximum_distance: maximum_distance must be a number from 0"),
        (["assess", "-p", "pacing"], "-p pacing: must be NAME:=VALUE"),
        (["probe", "-p", "curve:=true"], "unknown key curve"),
        (["assess", "--out=\udcff"], "'--out=\\udcff' has bytes that are no text in UTF-8"),
        (["compare", "a", "b", "--out", "x\udcff"], "'x\\udcff' has bytes that are no text in UTF-8"),
    ],
)
def test_what_no_option_takes_is_said_before_any_work(capsys, words, said):
    assert run_skd(*words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


Run = Callable[..., subprocess.CompletedProcess[str]]
SCENARIO = "name: mine\ndescription: mine\nextends: cpna-75\n"
READ = [
    ["replay", "{}/file"],
    ["compare", "other", "{}/file"],
    ["scenarios", "check", "{}/mine.yaml"],
    ["fuse", "other", "{}/file"],
    ["assess", "--fail-if-worse-than", "{}"],
    ["assess", "--scenario", "{}/mine.yaml"],
    ["assess", "--safe", "{}/ways"],
    ["assess", "--car-model", "{}/file"],
    ["assess", "--behaviour", "{}/file"],
    ["assess", "--message-folder", "{}/messages"],
    ["assess", "--controller", "cars_in_it:Fine"],
    ["protocol", "ncap", "--scenarios", "cpna,{}/mine.yaml"],
]


@pytest.mark.parametrize("words", READ, ids=" ".join)
def test_every_input_is_kept(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Straight into the folder, through a link, and by a way round."""
    (tmp_path / "base").mkdir()
    for name, text in (("assessment.json", "{}"), ("mine.yaml", SCENARIO), ("cars_in_it.py", CONTROLLERS)):
        (tmp_path / "base" / name).write_text(text)
    (tmp_path / "link").symlink_to("base")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path / "base"))
    for folder, out in (("base", "base"), ("link", "base"), ("base", "link"), ("other/../base", "base")):
        filled = [word.format(folder) for word in words]
        found = make_parser().parse_args([*filled, "--out", out, "--overwrite"])
        with pytest.raises(UsageError, match="which this command reads; give another folder"):
            result_folder(found)


def test_a_campaign_keeps_what_it_reads_and_can_be_resumed(skd_here: Run, here: Path) -> None:
    """Its own file may lie in its folder, which stays; what its cells read may not."""
    counts = "safe_count: 1, kamikaze_count: 1, collision_runs: 1, simulations: 10, margin_limit: 0, behaviour: none"
    text = f"defaults: {{{counts}}}\ncars: [{{controller: basic, name: mine}}]\n"
    (here / "campaign.yaml").write_text(text)
    words = ("campaign", "campaign.yaml", "--out", "out", "--workers", "1")
    assert skd_here(*words).returncode == 0
    (here / "out" / "mine" / "own.csv").write_text(CROSSING)
    (here / "campaign.yaml").write_text(f"{text}scenarios: [{{safe: out/mine/own.csv, name: there}}]\n")
    one_line(skd_here(*words, "--overwrite"), 2, "holds out/mine/own.csv, which this command reads")
    (here / "campaign.yaml").write_text(text)
    (here / "campaign.yaml").rename(here / "out" / "campaign.yaml")
    words = ("campaign", "out/campaign.yaml", "--out", "out", "--workers", "1")
    for how in ("--resume", "--overwrite"):
        done = skd_here(*words, how)
        assert done.returncode == 0, done.stderr
        assert (here / "out" / "campaign.yaml").read_text() == text


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
