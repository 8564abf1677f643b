"""Terminal manners: JSON alone on standard output, suggestions, completion, and tables that fit where they go."""

from __future__ import annotations

import json
import re

import pytest
from cli_support import SMALL, names, one_line, skd_from_nothing
from rich.table import Table
from skd_evaluator.report.progress import ProgressLines
from skd_evaluator.report.tables import equal_remarks
from skd_evaluator.report.terminal import narrow_table, print_table

NOISY = """
import ctypes, os, subprocess, sys
libc = ctypes.CDLL(None)
print("imported", flush=True)

class Car:
    def reset(self, scenario, rng):
        print("reset")
        libc.puts(b"from C")  # kept by C until the process ends
        os.write(1, b"raw ")
        subprocess.run(["echo", "from a child"])
    def command(self, car, adversary):
        sys.stdout.write("command "); sys.stdout.flush()
        sys.__stdout__.write("again "); sys.__stdout__.flush()
        return 0.0
"""


def test_json_is_alone_whatever_a_controller_prints(here):
    (here / "noisy.py").write_text(NOISY)
    noisy = ("--safe", "good.csv", "--adversary-model", "generic", "--controller", "noisy:Car")
    done = skd_from_nothing("assess", *SMALL, *noisy, "--json", "--no-pictures", "--out", "out", cwd=here)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == json.loads((here / "out" / "assessment.json").read_text(encoding="utf-8"))
    for said in ("imported", "reset", "raw ", "from a child", "command "):
        assert said in done.stderr


def test_quiet_prints_nothing_and_verbose_where_an_error_comes_from(skd_here, here):
    done = skd_here("assess", *SMALL, "--safe", "good.csv", "--quiet", "--out", "quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert "assessment.json" in names(here / "quiet")
    done = skd_here("assess", *SMALL, "--safe", "missing.csv", "-v")
    assert "Traceback" in done.stderr
    one_line(skd_here("assess", *SMALL, "-v", "-q"), 2, "not allowed with")


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["asess"], "assess"),
        (["assess", "--multiplyer=1"], "--multiplier"),
        (["assess", "--controller", "bassic"], "basic"),
        (["assess", "--controller", "Carla"], "carla"),
        (["assess", "--scenario", "crosing"], "crossing"),
        (["sweep", "--objective", "papper"], "paper"),
        (["assess", "--graph", "--pacing", "lock_step"], "lockstep"),
    ],
)
def test_a_wrong_name_brings_the_right_one(skd_here, arguments, meant):
    one_line(skd_here(*arguments), 2, f"did you mean {meant!r}?")


def a_table(cells: int = 3) -> Table:
    table = narrow_table("A title")
    for number in range(cells):
        table.add_column(f"column\n{number}", justify="right" if number else "left")
    table.add_row("[red]short[/]", *["a cell"] * (cells - 1))
    table.add_section()
    table.add_row("φ of some length", *[""] * (cells - 1))
    return table


def test_tables_are_plain_without_a_terminal(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    monkeypatch.setenv("FORCE_COLOR", "")
    print_table(a_table())
    lines = capsys.readouterr().out.splitlines()
    assert all(line == line.rstrip() for line in lines)
    assert "\x1b" not in "".join(lines)
    assert not re.search("[─-╿]", "".join(lines))
    assert max(map(len, lines)) < 60
    monkeypatch.setenv("COLUMNS", "30")
    print_table(a_table(8))
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 30


def test_results_that_are_the_same_to_the_last_digit_are_remarked_on():
    one = {"margin": 0.5, "deviation": 1.0, "skd": 2.0, "nominal_collision_rate": 0.1}
    rows = [{"name": "a", **one}, {"name": "b", **one, "skd": 2.0000001}, {"name": "c", **one}]
    (line,) = equal_remarks(rows, "name")
    assert line.startswith("a and c have the same figures to the last digit")
    unknown = dict.fromkeys(one)
    assert equal_remarks([{"name": "a", **unknown}, {"name": "b", **unknown}], "name") == []


# --- how far it is


def test_a_step_has_one_line_and_then_one_a_minute():
    now, written = [0.0], []
    lines = ProgressLines(lambda label, rest: written.append(label + rest), lambda: now[0])
    for second in range(200):
        now[0] = float(second)
        lines.update("kamikazes" if second < 30 else f"margin, {second // 50}", second + 1, 200)
    assert written[:2] == ["kamikazes (200)", "margin"]
    assert len(written) == len(set(written)) == 4
    assert written[2] == "margin, 1, 91 of 200, 0:01:49 left"
