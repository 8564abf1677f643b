"""The equivalent multiplier as each output shows it: one figure, and under each heading the interval that it names."""

from __future__ import annotations

import json
import math
import re

import pytest
from report_support import edited
from skd_evaluator.metrics.margins import EquivalentMultiplier, equivalent_entries
from skd_evaluator.report.html import page
from skd_evaluator.report.html.subjects import read_subjects
from skd_evaluator.report.summary import markdown
from skd_evaluator.report.tables import comparison_table
from skd_evaluator.report.terminal import details_table, print_table

INF = math.inf
FOUND = {  # C, the interval by φ, the one on these φ; how C and the two read
    "inside": (0.75, (0.7, 0.8), (0.625, 0.875), "0.750", "0.700, 0.800", "0.625, 0.875"),
    "one end": (1.25, (1.0, 1.375), (1.125, INF), "1.250", "1.000, 1.375", "1.125, above 1.5"),
    "above": (INF, (INF, INF), (1.375, INF), "above 1.5", "above 1.5, above 1.5", "1.375, above 1.5"),
    "below": (-INF, (-INF, -INF), (-INF, 0.625), "below 0.5", "below 0.5, below 0.5", "below 0.5, 0.625"),
    "one φ": (0.75, None, (0.625, 0.875), "0.750", None, "0.625, 0.875"),
}
NAME = "equivalent_multiplier"


def html_cells(folder) -> list[str]:
    """Value, interval by φ and the other one, of the table of ratings."""
    html = page.render(read_subjects([folder]))
    (row,) = re.findall(r'<th scope="row">equivalent multiplier C</th>(.*?)</tr>', html)
    return re.findall(r'<td data-label="[^"]*" class="n[^"]*">(.*?)</td>', row)


@pytest.mark.parametrize("case", FOUND)
def test_every_output_shows_the_same_under_the_same_heading(case, sweep, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    *figures, value, by_phi, plain = FOUND[case]
    found = EquivalentMultiplier(*figures, 0.5, 1.5)
    changes = {**equivalent_entries(found), f"{NAME}_note": ""}
    folder = edited(sweep / "synthetic" / "C_1", tmp_path / "one", **changes)
    result = json.loads((folder / "assessment.json").read_text(encoding="utf-8"))

    for name, ends in (("ci95", found.ci95), ("ci95_these_phi", found.ci95_trials)):
        kept = result[f"{NAME}_{name}"]
        assert kept == (None if ends is None else [end if math.isfinite(end) else None for end in ends])

    print_table(details_table(result))
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    (alone,) = [line for line in lines if line.startswith("equivalent multiplier")]
    assert alone.startswith(f"equivalent multiplier C {value} {f'[{by_phi}]' if by_phi else '—'} [{plain}]")

    rows = [line for line in markdown(result, []).splitlines() if line.startswith("|")]
    assert rows[0] == "| | value | 95 % by φ | 95 %, as independent |"
    assert f"| equivalent multiplier C | {value} | {f'[{by_phi}]' if by_phi else '—'} | [{plain}] |" in rows

    shown = [by_phi.replace(", ", " to ") if by_phi else "–", plain.replace(", ", " to ")]
    assert html_cells(folder) == [value, *shown]

    print_table(comparison_table([{**result, "car": "mine"}], None))
    (row,) = [line for line in capsys.readouterr().out.splitlines() if line.lstrip().startswith("mine")]
    assert f" {value}" in row
