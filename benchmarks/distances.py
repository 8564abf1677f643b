"""Draw what deformation and discrete Fréchet distance measure, on two pairs (φ, ψ) of the basic car.

    python benchmarks/distances.py --picture docs/figures/distances.png

Of kamikazes along three synthetic φ it takes the one whose deformation exceeds the Fréchet distance most, which waits,
and the one of which the contrary holds, which hurries. Prints both distances of both.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from skd_evaluator import palette
from skd_evaluator.campaign.plan.plan import Plan, kamikaze_sets, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.measure.distances.deformation import deformation
from skd_evaluator.measure.distances.frechet import discrete_frechet
from skd_sim.arrays import FloatArray
from skd_sim.choices.objective import Objective
from skd_sim.encounter.scenario import load_scenario

Pair = tuple[FloatArray, FloatArray, float]
Links = list[tuple[FloatArray, FloatArray]]
KAMIKAZES = {  # objective, C, and which distance is to be the greater one
    "waits": (Objective.FRECHET, 1.3, 1.0),
    "hurries": (Objective.PAPER, 1.0, -1.0),
}


def couple(phi: FloatArray, psi: FloatArray) -> list[tuple[int, int]]:
    """Return the links of a coupling whose longest one is as short as can be, by Eiter and Mannila's table."""
    gap = np.linalg.norm(phi[:, None] - psi[None, :], axis=2)
    table = np.full((len(phi) + 1, len(psi) + 1), np.inf)
    table[0, 0] = 0.0
    for i, j in np.ndindex(gap.shape):
        table[i + 1, j + 1] = max(min(table[i, j + 1], table[i + 1, j], table[i, j]), gap[i, j])
    links = [(len(phi) - 1, len(psi) - 1)]
    while links[-1] != (0, 0):
        i, j = links[-1]
        before = [(i - 1, j - 1), (i - 1, j), (i, j - 1)]
        links.append(min(before, key=lambda place: table[place[0] + 1, place[1] + 1] if min(place) >= 0 else np.inf))
    return links[::-1]


def find_pair(objective: Objective, multiplier: float, sign: float, attempts: int) -> Pair:
    """Return φ, ψ and the time of the contact (ticks) of the kamikaze in which the distances differ most."""
    scenario = load_scenario("crossing")
    plan = Plan(scenario, multiplier=multiplier, safe_count=3, kamikaze_count=attempts, objective=objective)
    with InProcessRunner(1) as runner:
        sets = kamikaze_sets(plan, safe_trajectories(plan, runner), runner)
    pairs = [
        (found.safe_trajectory.positions, log.trajectory.positions, log.impact_time / scenario.time_step)
        for found in sets
        for log in found.logs
    ]
    return max(pairs, key=lambda pair: sign * (deformation(*pair) - discrete_frechet(*pair[:2])))


def links_of_times(phi: FloatArray, psi: FloatArray, duration: float) -> Links:
    """Return each place of ψ with where φ is at that time, φ held at its end."""
    ticks = np.arange(len(phi))
    times = np.append(np.arange(len(psi) - 1), duration)
    return [
        (np.array([np.interp(time, ticks, phi[:, axis]) for axis in (0, 1)]), place)
        for time, place in zip(times, psi, strict=True)
    ]


def draw(path: Path, pairs: dict[str, Pair]) -> None:
    """Draw each pair with the links of both distances, the longest link of each in full."""
    figure, axes = plt.subplots(len(pairs), 2, figsize=(10, 5.4), layout="constrained", sharex=True, sharey=True)
    for row, (name, (phi, psi, duration)) in zip(axes, pairs.items(), strict=True):
        links = {
            f"{name}: deformation {deformation(phi, psi, duration):.2f} m": links_of_times(phi, psi, duration),
            f"{name}: Fréchet distance {discrete_frechet(phi, psi):.2f} m": [
                (phi[i], psi[j]) for i, j in couple(phi, psi)
            ],
        }
        for axis, (title, linked) in zip(row, links.items(), strict=True):
            draw_panel(axis, title, phi, psi, linked)
        row[0].set_ylabel("y, North (m)")
    for axis in axes[-1]:
        axis.set_xlabel("x, East (m)")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_panel(axis: Axes, title: str, phi: FloatArray, psi: FloatArray, links: Links) -> None:
    """Draw one pair with one kind of links."""
    longest = max(range(len(links)), key=lambda k: float(np.linalg.norm(links[k][0] - links[k][1])))
    shown = next(k for k in range(len(links)) if k != longest)
    for number, link in enumerate(links):
        full = number == longest
        label = "longest link" if full else "link" if number == shown else None
        color, width = (palette.ALERT, 2.5) if full else (palette.ROAD_EDGE, 0.9)
        axis.plot(*np.array(link).T, color=color, lw=width, ls="-" if full else "--", label=label, zorder=1)
    axis.plot(*phi.T, "o-", color=palette.SAFE, ms=5, label="φ, a dot each tick")
    axis.plot(*psi.T, "s-", color=palette.KAMIKAZE, ms=4, label="ψ")
    axis.plot(*psi[-1], "X", color=palette.KAMIKAZE, ms=12, label="contact")
    axis.set_title(title, fontsize=11)
    axis.set_aspect("equal")
    axis.margins(y=0.15)
    axis.grid(alpha=0.3)


def main() -> None:
    """Find the pairs, draw them and print their distances."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--attempts", type=int, default=15, metavar="N", help="for each φ (default 15)")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    pairs = {name: find_pair(*kamikaze, arguments.attempts) for name, kamikaze in KAMIKAZES.items()}
    if arguments.picture is not None:
        draw(arguments.picture, pairs)
    for name, (phi, psi, duration) in pairs.items():
        strayed, apart = deformation(phi, psi, duration), discrete_frechet(phi, psi)
        print(f"{name}: deformation {strayed:.3f} m, discrete Fréchet distance {apart:.3f} m")


if __name__ == "__main__":
    main()
