"""Simulated against physical, a panel for each figure: pairs, what the simulator says of every φ, the line, the gap."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skd_evaluator import palette
from skd_evaluator.extensions.fusion.fusion import FusedFigure
from skd_evaluator.report.drawing import save_picture


def save_fusion(path: Path, figures: Sequence[FusedFigure]) -> None:
    """Draw every figure: above physical over simulated, below the gap from trial to trial."""
    picture = Figure(figsize=(4.4 * len(figures) + 0.4, 7.4), layout="constrained")
    panels = picture.subplots(2, len(figures), squeeze=False, height_ratios=[2.2, 1.0])
    for column, one in enumerate(figures):
        _draw_pairs(panels[0, column], one)
        _draw_order(panels[1, column], one)
    save_picture(picture, path)


def _draw_pairs(axes: Axes, one: FusedFigure) -> None:
    unit = f" ({one.figure.unit})" if one.figure.unit else ""
    pairs = one.pairs
    said = np.concatenate([pairs.simulated, pairs.population])
    low, high = float(min(pairs.physical.min(), said.min())), float(max(pairs.physical.max(), said.max()))
    ends = np.array([said.min(), said.max()])
    axes.plot(ends, ends, color=palette.ROAD_EDGE, dashes=(4, 2), linewidth=1.0, label="no gap")
    if one.with_simulator is not None and one.line.slope is not None:
        fitted = pairs.physical.mean() + one.line.slope * (ends - pairs.simulated.mean())
        axes.plot(ends, fitted, color=palette.BLUE, linewidth=1.4, label="line through the pairs")
    axes.scatter(pairs.simulated, pairs.physical, s=22, color=palette.VERMILLION, zorder=3, label="a φ with trials")
    level = low - 0.04 * (high - low)
    axes.plot(
        pairs.population,
        np.full(pairs.population.size, level),
        "|",
        color=palette.CAR,
        alpha=0.35,
        label="a simulated φ",
    )
    stands = one.stands
    middle = float(pairs.population.mean())
    reach = [[stands.value - stands.interval[0]], [stands.interval[1] - stands.value]]
    axes.errorbar(
        [middle], [stands.value], yerr=reach, fmt="D", color="black", capsize=4, zorder=4, label="what stands"
    )
    correlation = "–" if one.line.correlation is None else f"{one.line.correlation:.2f}"
    verdict = "the simulator predicts" if one.predicts else "physical trials stand alone"
    axes.set_title(f"{one.figure.text}\n{verdict} (ρ = {correlation})", fontsize=10)
    axes.set_xlabel(f"simulated{unit}")
    axes.set_ylabel(f"physical{unit}")
    axes.legend(fontsize=7, frameon=False)


def _draw_order(axes: Axes, one: FusedFigure) -> None:
    unit = f" ({one.figure.unit})" if one.figure.unit else ""
    off = one.pairs.trials - one.pairs.predicted
    axes.axhline(0.0, color=palette.ROAD_EDGE, dashes=(4, 2), linewidth=1.0)
    axes.scatter(np.arange(1, off.size + 1), off, s=14, color=palette.VERMILLION)
    axes.set_xlabel("physical trial, in the order in which they were made")
    axes.set_ylabel(f"gap{unit}")
