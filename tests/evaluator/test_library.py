"""Assessments from Python: the same numbers as the command line's."""

import json
import sys

import pytest
from common import run_program, run_skd
from skd_evaluator import AssessmentError, assess, library, load_result
from skd_sim import UsageError

SMALL = {"safe_count": 2, "kamikaze_count": 3, "collision_runs": 4, "simulations": 50, "seed": 3, "behaviour": "none"}
WHEN_AND_WHERE = ("seconds", "provenance")


def figures(found: dict[str, object]) -> dict[str, object]:
    return {key: value for key, value in found.items() if key not in WHEN_AND_WHERE}


def test_it_gives_what_the_command_gives(tmp_path):
    rating = assess("basic", multiplier=1.15, workers=2, out=tmp_path / "library", **SMALL)
    words = [part for name, value in SMALL.items() for part in (f"--{name.replace('_', '-')}", str(value))]
    assert run_skd("assess", "--multiplier", 1.15, *words, "--out", tmp_path / "command", "--quiet") == 0
    stored = [json.loads((tmp_path / name / "assessment.json").read_text()) for name in ("library", "command")]
    assert figures(stored[0]) == figures(stored[1])
    assert figures(json.loads(json.dumps(rating.as_dict()))) == figures(stored[1])
    assert load_result(tmp_path / "library").figures["margin"] == stored[1]["margin"]


def test_wrong_options_are_refused_in_one_line(tmp_path):
    with pytest.raises(UsageError, match=r"assess: unknown key kamikaze_cuont; did you mean 'kamikaze_count'"):
        assess("basic", kamikaze_cuont=3)
    with pytest.raises(UsageError, match="safe_count"):
        assess("basic", safe_count="many")
    with pytest.raises(UsageError, match="unknown controller 'nobody'"):
        assess("nobody")
    with pytest.raises(UsageError, match="needs the node graph"):
        assess("external")
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "file").write_text("")
    with pytest.raises((UsageError, AssessmentError), match="there"):
        assess("basic", out=tmp_path / "there", **SMALL)


def test_an_assessment_that_fails_lets_go_of_its_folder(tmp_path, monkeypatch):
    def fail(*_):
        raise AssessmentError("the car failed")

    monkeypatch.setattr(library, "assess_in_process", fail)
    with pytest.raises(AssessmentError) as first:  # which holds all frames of the call
        assess("basic", out=tmp_path / "out")
    with pytest.raises(AssessmentError, match="the car failed"):
        assess("basic", out=tmp_path / "out")
    assert first.value
    assert not (tmp_path / "out").exists()


THREADS = """
import threading
from skd_evaluator import assess

OPTIONS = dict(safe_count=2, kamikaze_count=1, collision_runs=4, simulations=10, adversary_model="generic", workers=1)

def one():
    print(assess("honest:Car", margin_limit=8, behaviour="none", **OPTIONS).as_dict()["margin"], flush=True)

if __name__ == "__main__":
    threads = [threading.Thread(target=one) for _ in range(2)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
"""
HONEST = """
class Car:
    def reset(self, scenario, rng):
        pass

    def command(self, car, adversary):
        return -6.0 if 0.0 <= adversary.y - car.y <= 12.0 and abs(adversary.x - car.x) < 2.0 else 0.0
"""


def test_two_threads_assess_a_car_of_a_users_own(tmp_path):
    """They hung for ever: of one a worker had been forked while the other was starting a program."""
    (tmp_path / "honest.py").write_text(HONEST)
    (tmp_path / "threads.py").write_text(THREADS)
    done = run_program(sys.executable, "threads.py", cwd=tmp_path)
    first, second = map(float, done.stdout.splitlines())
    assert first == second > 0.0
