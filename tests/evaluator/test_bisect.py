"""Which commit made a car worse: the test of a revision, and the command on a repository with a known answer."""

import itertools
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import BRAKE, CROSSING, SMALL, git, one_line, skd
from skd_evaluator import load_result
from skd_evaluator.assessment.from_options import plan_of
from skd_evaluator.cli.assessment import begun_with, digest_of_inputs
from skd_evaluator.cli.main import main, make_parser, parse
from skd_evaluator.margin.paired_test import ERROR, SCALE, e_values, level_of
from skd_sim.scenario.scenario import load_scenario

CAR = "import limits\n\n" + BRAKE.format(name="Brake", side="limits.SIDE")
HISTORY = {  # what each commit changes, and its message
    "start": [("src/team/__init__.py", ""), ("src/team/cars.py", CAR), ("lib/limits.py", "SIDE = 1.5\n")],
    "other words": [("src/team/cars.py", CAR.replace("time", "after"))],
    "broken": [("lib/limits.py", "SIDE = 1.5  #\nraise ValueError('no')\n")],
    "stands": [
        ("lib/limits.py", "SIDE = 1.5\n"),
        ("src/team/cars.py", CAR.replace("return 0.0", "return -7.0").replace("else 0.0", "else -7.0")),
    ],
    "mended": [("src/team/cars.py", CAR.replace("time", "after"))],
    "worse": [("lib/limits.py", "SIDE = 0.9\n")],  # of the same size, and within the second
    "more words": [("src/team/cars.py", CAR.replace("aside", "left"))],
    "notes": [("notes.md", "nothing of the car\n")],
}
OPTIONS = ("--", "scripts/skd", "assess", "--controller", "team.cars:Brake", "--safe-count", "12", "--seed", "3")


@pytest.fixture(scope="module")
def repository(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A repository whose car imports from a folder of its own on PYTHONPATH; tags name its commits."""
    made = tmp_path_factory.mktemp("repository")
    git(made, "init", "-q")
    for message, changes in HISTORY.items():
        for file, text in changes:
            (made / file).parent.mkdir(parents=True, exist_ok=True)
            (made / file).write_text(text, encoding="utf-8")
        git(made, "add", "-A")
        git(made, "commit", "-qm", message)
        git(made, "tag", message.replace(" ", "-"))
    return made


def bisect(repository: Path, *words: str) -> subprocess.CompletedProcess[str]:
    path = f"{repository}/src:{repository}/lib"
    return skd("bisect", *words, *OPTIONS, cwd=repository, PYTHONPATH=path)


def test_a_fair_coin_seldom_wins_and_never_on_average():
    flips = SCALE * np.array(list(itertools.product((-1.0, 1.0), repeat=12)))
    capital = np.array([e_values(one) for one in flips])
    assert capital[:, -1].mean() == pytest.approx(1.0)
    assert (capital.max(axis=1) >= 1.0 / ERROR).mean() <= ERROR


def test_greater_differences_count_as_the_scale_and_none_as_nothing():
    shares = np.linspace(0.1, 0.9, 9)
    assert e_values(np.array([9.0, 0.0, -SCALE / 2]))[-1] == pytest.approx(((1 + shares) * (1 - shares / 2)).mean())


def test_the_level_grows_with_the_verdicts_that_a_bisection_takes():
    assert [level_of(count) * ERROR for count in (1, 2, 64, 65)] == [2, 3, 8, 9]


def test_the_commit_is_found_and_shown_by_a_trial(repository, tmp_path):
    (repository / "lib" / "limits.py").write_text("a change that is not committed", encoding="utf-8")
    before = git(repository, "status", "--porcelain", "--branch")
    found = bisect(repository, "start", "notes", "--out", str(tmp_path / "out"), "--json")
    assert found.returncode == 0, found.stderr
    content = json.loads(found.stdout)
    assert content["first_bad"] == git(repository, "rev-parse", "worse")
    verdicts = {one["commit"]: one for one in content["tested"]}
    assert verdicts[git(repository, "rev-parse", "mended")]["why"] == "drives exactly like a revision that is judged"
    (trial,) = (tmp_path / "out").glob("*/trajectory.csv")
    assert content["only_one_hits"]["folder"] == trial.parent.name
    assert "'team.cars:Brake'" in (trial.parent / "test_hit.py").read_text()
    assert git(repository, "status", "--porcelain", "--branch") == before
    assert len(git(repository, "worktree", "list").splitlines()) == 1
    again = bisect(repository, "start", "notes", "--out", str(tmp_path / "again"), "--json")
    tested = json.loads(again.stdout)["tested"]
    judged = {one["why"] for one in tested if one["verdict"] != "skip"}
    assert judged == {"has the same files as a revision that is judged"}


@pytest.mark.parametrize(
    ("commit", "code", "why"),
    [
        ("start", 0, "good, has the same files"),
        ("more-words", 1, "bad, has the same files"),
        ("broken", 125, "skip, "),
        ("stands", 125, "skip, "),
    ],
)
def test_the_commit_that_is_checked_out_is_judged_for_git_bisect_run(repository, commit, code, why):
    git(repository, "checkout", "-qf", commit)
    done = bisect(repository, "start", "notes", "--here")
    assert (done.returncode, why in done.stdout) == (code, True), done.stdout + done.stderr


def test_what_cannot_be_bisected_ends_in_one_line(repository, tmp_path):
    out = ("--out", str(tmp_path / "out"))
    one_line(bisect(repository, "more-words", "notes", *out), 2, "have the same files")
    one_line(bisect(repository, "start", "nowhere", *out), 2, "nowhere: no such commit")
    one_line(skd("bisect", "start", "notes", *out, "--", "--graph", cwd=repository), 2, "--graph")
    one_line(skd("bisect", "start", "notes", *out, cwd=repository), 2, "--controller basic: give one of your own")
    (repository / "new.py").write_text(CAR)
    new = skd("bisect", "start", "notes", *out, "--", "--controller", "new.py:Brake", cwd=repository)
    (repository / "new.py").unlink()
    one_line(new, 2, "--controller new.py:Brake: new.py is not in git; add and commit it")
    assert bisect(repository, "start", "nowhere", "--here").returncode == 128
    assert "not shown to be worse" in bisect(repository, "worse", "mended", *out).stderr


def test_two_revisions_are_rated_with_the_same_options_and_compared(repository, tmp_path):
    git(repository, "checkout", "-qf", "notes")
    small = ("--safe-count", "1", "--kamikaze-count", "2", "--collision-runs", "1", "--margin-limit", "8")
    small += ("--behaviour", "none", "--adversary-model", "generic")
    out, path = tmp_path / "out", f"{repository}/src:{repository}/lib"
    words = ("compare", "--rev", "mended", "worse", "--explain", "--no-pictures", "--json", "--out", str(out))
    done = skd(*words, *OPTIONS, *small, cwd=repository, PYTHONPATH=path)
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    margins = {row["car"]: row["margin"] for row in content["rows"]}
    assert margins["Brake-worse"] < margins["Brake-mended"]
    assert {load_result(row["folder"]).figures["car"] for row in content["rows"]} == set(margins)
    assert any(f"the margin of {out}/Brake-worse is at most" in line for line in content["warnings"])
    assert "skd-revisions-" not in done.stdout + done.stderr
    trials = {one["hits"]: one["folder"] for one in content["only_one_hits"]}
    assert "'team.cars:Brake'" in (out / trials["Brake-worse"] / "test_hit.py").read_text()
    one_line(skd("compare", str(out), "--rev", "mended", "worse", *OPTIONS, cwd=repository), 2, "leave out the folders")


def test_a_night_in_which_nothing_changed_takes_the_result_over(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("cars.py").write_text(BRAKE.format(name="Brake", side=1.5) + "class Later(Brake):\n    limit = 1.1\n")
    words = ["assess", *SMALL, "--adversary-model", "generic", "-q"]

    def night(name: str, car: str, *more: str) -> dict[str, Any]:
        assert main([*words, "--controller", f"cars.py:{car}", "--out", name, *more]) == 0
        return dict(load_result(name).figures)

    first, second = night("first", "Brake"), night("second", "Brake", "--warm-start", "first")
    assert second["margin_how"] == "as in first: the same car and options, and each hit came again"
    differ = {key for key in first if first[key] != second[key]}
    assert differ == {"provenance", "margin_how", "seconds"}
    assert night("third", "Later", "--warm-start", "first")["margin_how"] == "from the hits of first on"


def test_a_night_is_of_all_files_and_options_but_the_earlier_result(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("phi.csv").write_text(CROSSING)
    Path("cars.py").write_text(BRAKE.format(name="Brake", side=1.5))

    def digest(*more: str) -> str | None:
        words = ["assess", "--safe", "phi.csv", "--controller", "cars.py:Brake", *more]
        arguments = parse(make_parser(["assess"]), words)
        arguments.command_line = ["skd", *words]
        return digest_of_inputs(begun_with(arguments, plan_of(vars(arguments), load_scenario("crossing"))), arguments)

    same = digest()
    assert same == digest("--warm-start", "first") is not None
    assert digest("--graph") is None
    others = [same, digest("--seed", "1"), digest("--max-aborted", "3")]
    for file, text in (("phi.csv", CROSSING.replace("2,3,0", "2.5,3,0")), ("cars.py", "# a comment\n")):
        Path(file).write_text(text)
        others.append(digest())
    assert len(set(others)) == 5
