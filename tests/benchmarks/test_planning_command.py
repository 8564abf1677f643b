"""The planning benchmark's command: options that are set, a row for each planner, and workers that end with it."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import planning
import pytest
from planner_choice import options_of, settings_of
from planning_problems import PROBLEMS
from skd_adversary.planning.options import Backup, Cells

BENCHMARKS = Path(planning.__file__).parent


def test_every_kind_of_option_can_be_set() -> None:
    texts = ["cells=LIKELIHOOD", "backup=MEAN", "observation_factor=inf", "keep_tree=true", "depth=7", "depth=9"]
    options = options_of("light_dark", "ours", settings_of("ours", texts))
    assert (options.cells, options.backup) == (Cells.LIKELIHOOD, Backup.MEAN)
    assert (options.observation_factor, options.keep_tree, options.depth) == (math.inf, True, 9)
    assert options.exploration == PROBLEMS["light_dark"].options.exploration
    assert settings_of("ours", ["exploration=none"]) == {"exploration": None}
    assert settings_of("ours", ["exploration=2.5"]) == {"exploration": 2.5}
    assert settings_of("pomcpow", ["most_visited=false"]) == {"most_visited": False}
    assert settings_of("pft_dpw", ["node_particles=5"]) == {"node_particles": 5}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--set sells=NEAREST", "ours has no option 'sells' to set; it has action_exponent, action_factor, backup"),
        ("--planner ours pomcpow --set most_visited=true", "ours has no option 'most_visited'"),
        ("--set cells=NEAR", "cells=NEAR: expected LIKELIHOOD or NEAREST"),
        ("--set depth=inf", "depth=inf: expected a whole number"),
        ("--set exploration=nan", "exploration=nan: expected a number"),
        ("--set depth=none", "depth=none: expected a whole number"),
        ("--set keep_tree=1", "keep_tree=1: expected true or false"),
        ("--set depth", "depth: expected depth=VALUE"),
        ("--set particles=0", "at least one particle"),
        ("--set simulations=5", "given as --simulations N"),
        ("--simulations 0", "must be positive"),
    ],
)
def test_what_cannot_be_set_is_said_in_one_line(
    words: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["planning.py", "--problems", "light_dark", *words.split()])
    with pytest.raises(SystemExit) as left:
        planning.main()
    assert left.value.code == 2
    assert said in capsys.readouterr().err.splitlines()[-1]


def _main(words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    monkeypatch.setattr(sys, "argv", ["planning.py", *words.split()])
    planning.main()
    return capsys.readouterr().out


def test_each_planner_has_a_row_and_what_is_set_a_record_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    planners = ("ours", "default_policy")
    record = tmp_path / "episodes.jsonl"
    command = (
        f"--problems sub_hunt_at_random --planner {' '.join(planners)} --episodes 2 --simulations 30 --record {record}"
    )
    result: dict[str, Any] = json.loads(_main(f"{command} --json", monkeypatch, capsys))["sub_hunt_at_random"]
    assert set(result) == {"published", *planners}
    begun = record.read_text()
    assert begun.count("\n") == 2 * len(planners)
    rows = [line.split() for line in _main(command, monkeypatch, capsys).splitlines()]
    assert record.read_text() == begun  # not run again
    assert rows[0] == ["sub_hunt_at_random"]
    assert [row[3] for row in rows[1:]] == [f"{planner}," for planner in planners]
    assert [float(row[0]) for row in rows[1:]] == pytest.approx([result[p]["mean"] for p in planners], abs=0.006)
    monkeypatch.setattr(planning, "worker_processes", ThreadPoolExecutor)
    _main(f"{command} --set exploration=7", monkeypatch, capsys)
    added = [json.loads(line)["run"]["options"] for line in record.read_text()[len(begun) :].splitlines()]
    assert len(added) == 2 * len(planners)
    assert all("exploration=7.0" in options for options in added)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_parent(number: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        textwrap.dedent(f"""
            import os, sys, time
            sys.path.insert(0, {str(BENCHMARKS)!r})
            from worker_processes import worker_processes

            def work(seconds):
                print(os.getpid(), flush=True)
                time.sleep(seconds)

            if __name__ == "__main__":
                with worker_processes(2) as pool:
                    jobs = [pool.submit(work, 600.0) for _ in range(9)]
                    jobs[0].result()
        """)
    )
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as parent:
        assert parent.stdout is not None
        workers = {int(parent.stdout.readline()) for _ in range(2)}
        assert len(workers) == 2
        parent.send_signal(number)
        assert parent.wait(60) != 0
        until = time.monotonic() + 60
        while any(map(_runs, workers)):
            assert time.monotonic() < until
            time.sleep(0.01)


def _runs(pid: int) -> bool:
    """Whether a process is there that is more than an entry nobody has asked for."""
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False
