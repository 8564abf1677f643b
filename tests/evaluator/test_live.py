"""`skd campaign --live`: figures as cells end, on a terminal and elsewhere."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from skd_evaluator.metrics.aborted import NOT_CREDIBLE
from skd_evaluator.report.side_by_side import LiveTable, cell_line
from terminals import Terminal

ENDED = {
    "state": "done",
    "sha256": {"assessment.json": "00"},
    "margin": 0.637,
    "margin_ci95": [0.601, 0.678],
    "margin_converged": True,
    "equivalent_multiplier": 1.0,
    "nominal_collision_rate": 0.052,
    "deviation": 0.824,
    "knowledge": "known",
    "skd": 3.5,
    "problems": [],
}
OPEN = {**ENDED, "state": "open", "sha256": {}}


def drawn(live: LiveTable, height: int) -> list[str]:
    console = Console(file=io.StringIO(), width=80)
    console.print(live.table(height))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def test_cells_fill_a_table_that_fits_the_terminal():
    rows: list[dict[str, Any]] = [{**OPEN, "name": f"car-{number}"} for number in range(40)]
    live = LiveTable(rows)
    assert "0 of 40 cells" in drawn(live, 24)[0]
    for number in (7, 3, *range(10, 30)):
        rows[number] |= ENDED
        live.take(rows[number])
    for height in (14, 24, 80):
        lines = drawn(live, height)
        assert len(lines) <= height - 4
        assert "22 of 40 cells" in lines[0]
        assert any("car-29" in line and "0.637" in line for line in lines)  # the last one, at any height
    assert any("car-39" in line and "open" in line for line in drawn(live, 80))


def test_a_cell_in_a_line():
    row = {**ENDED, "name": "basic"}
    assert (
        cell_line(row) == "basic: margin 0.637 m (95 %: 0.601 to 0.678), nominal collision rate 5.2 %, planned 0.824 m"
    )
    assert "(not converged)" in cell_line({**row, "margin_converged": False})
    assert cell_line({**row, "warnings": [f"{NOT_CREDIBLE}it counts"]}).startswith(
        "basic (not credible): margin 0.637 m"
    )
    failed = {**OPEN, "name": "mine", "state": "failed", "problems": ["it ended"]}
    assert cell_line(failed) == "mine: failed: it ended"


def test_a_terminal_shows_figures_before_the_end(here: Path):
    """The first of two cells is there while the second runs."""
    sizes = {"safe_count": 1, "kamikaze_count": 2, "collision_runs": 3, "simulations": 20, "objective": "deviation"}
    content = {
        "defaults": {**sizes, "margin_limit": 8, "behaviour": "none", "safe": "good.csv"},
        "cars": [{"controller": "basic"}],
        "sweep": {"multiplier": [0.75, 1.0]},
    }
    (here / "campaign.yaml").write_text(json.dumps(content))
    words = ("campaign", str(here / "campaign.yaml"), "--live", "--workers", "1", "--out", str(here / "out"))
    terminal = Terminal([sys.executable, "-m", "skd_evaluator", *words], PYTHONPATH=str(here))
    terminal.wait_for("[01] of 2 cells")
    terminal.wait_for("What the cells came to")
    assert terminal.finish() == 0
    rows = json.loads((here / "out" / "campaign.json").read_text())["cells"]
    for row in rows:
        assert terminal.text.count(row["name"]) >= 2  # as it ended, and in the table at the end
        assert f"{row['margin']:.3f}" in terminal.text


@pytest.mark.parametrize("quiet", [True, False])
def test_elsewhere_each_cell_is_a_line(here: Path, skd_here, quiet):
    sizes = {"safe_count": 1, "kamikaze_count": 1, "collision_runs": 1, "simulations": 5, "objective": "deviation"}
    content = {
        "defaults": {**sizes, "margin_limit": 0, "behaviour": "none", "safe": "good.csv"},
        "cars": [{"controller": "basic"}],
    }
    (here / "campaign.yaml").write_text(json.dumps(content))
    done = skd_here("campaign", "campaign.yaml", "--live", "--workers", "1", "--out", "out", *["--quiet"] * quiet)
    said = [line for line in done.stderr.splitlines() if line.startswith("skd campaign: basic-C1: margin")]
    assert len(said) == (not quiet)
