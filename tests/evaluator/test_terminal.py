"""What a command prints, and the table of figures."""

import json
import multiprocessing
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cli_support import SMALL, names, one_line, skd_from_nothing
from rich.table import Table
from skd_evaluator.assessment.figure_table import AT_THE_TOP, FIGURES, OF_OBJECTIVES, OF_PHI, Of, shown_in
from skd_evaluator.assessment.files.assessment_json import assessment_schema
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.report.progress import COMPILING, progress_bar
from skd_evaluator.report.terminal import narrow_table, print_table
from skd_sim.kernels.compilation import on_compiling

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
        (["assess", "--kamikaze", "3"], "--kamikaze-count"),
        (["assess", "--controller", "bassic"], "basic"),
        (["assess", "--controller", "Carla"], "carla"),
        (["assess", "--scenario", "crosing"], "crossing"),
        (["explain", "a", "b"], "compare --explain"),
        (["assess", "--graph", "--pacing", "lock_step"], "lockstep"),
    ],
)
def test_a_wrong_name_brings_the_right_one(skd_here, arguments, meant):
    one_line(skd_here(*arguments), 2, f"did you mean {meant!r}?")


def test_of_all_workers_one_says_that_it_compiles(capfd):
    with progress_bar():
        for _ in range(2):
            worker = multiprocessing.get_context("fork").Process(target=lambda: on_compiling.pop()())
            worker.start()
            worker.join()
    assert capfd.readouterr().err == f"skd: {COMPILING}\n"


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


MEASURE = Path(__file__).parents[2] / "docs" / "metrics.md"


def test_a_result_has_the_rows_of_the_table_and_no_others(sweep):
    figures = json.loads((sweep / "synthetic" / "C_1" / "assessment.json").read_text())
    rows = [key for one in AT_THE_TOP.values() for key in one.keys if not one.optional or key in figures]
    assert list(figures) == rows
    for objective in figures["objectives"].values():
        assert set(objective) == {key for one in OF_OBJECTIVES.values() for key in one.keys}
        assert {key for row in objective["per_safe_trajectory"] for key in row} == set(OF_PHI)
    at_the_top = {one.key for one in FIGURES if one.of is Of.PHI_TOP}
    assert {key for row in figures["per_safe_trajectory"] for key in row} == set(OF_PHI) | at_the_top


def without_description(node: Any, path: str) -> Iterator[str]:
    for key, one in node.get("properties", {}).items():
        if not one.get("description"):
            yield f"{path}.{key}"
    for key, one in node.items():
        for inside in one if isinstance(one, list) else [one]:
            if isinstance(inside, dict):
                yield from without_description(inside, f"{path}.{key}")


def test_the_schema_says_what_every_key_is():
    assert list(without_description(assessment_schema(), "")) == []


def test_what_is_shown_to_people_has_a_name_and_a_figure_behind_it(sweep):
    for output in ("summary", "details", "chart"):
        assert all(one.label and one.key in AT_THE_TOP for one in shown_in(output))
    assert {one.key for one in shown_in("difference")} <= set(read_result(sweep / "synthetic" / "C_1").groups)


def test_the_documents_name_the_first_figures_and_which_way_is_better():
    rows = re.findall(r"^\| \*\*(.+?)\*\*(.*?) \|.*\| (.+?) \|$", MEASURE.read_text(encoding="utf-8"), re.MULTILINE)
    said = {name + rest: better for name, rest, better in rows}
    first = [one for one in shown_in("summary") if one.first]
    assert said == {one.title.partition(",")[0]: str(one.better) for one in first}
