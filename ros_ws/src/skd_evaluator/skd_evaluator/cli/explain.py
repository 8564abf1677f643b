"""What tells two cars apart, in words, as a picture, and as files that any command and pytest drive again."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from skd_sim.inputs.files import from_here
from skd_sim.world.episode import EpisodeLog, Outcome, until_contact

from skd_evaluator import palette
from skd_evaluator.margin.common_trajectories import DistinguishingTrial
from skd_evaluator.report.pictures import ShownEpisode, save_episode, save_picture
from skd_evaluator.report.repeat import SCENARIO_FILE, TRAJECTORY_FILE, program, write_trial

_TEST = '''"""A road user {deviation:.2f} m from a safe trajectory: the car must not hit it.

Run pytest where skd was run: a car's file is named from there.
"""

from pathlib import Path

from skd_evaluator import assess

HERE = Path(__file__).parent


def test_the_car_does_not_hit() -> None:
    scenario, safe = HERE / "scenario.yaml", HERE / "trajectory.csv"
    one = {{"safe_count": 1, "kamikaze_count": 1, "collision_runs": 1, "margin_limit": 0}}
    few = {{**one, "adversary_model": "generic", "behaviour": "none"}}
    found = assess({car}, scenario=str(scenario), safe=str(safe), seed={seed}, **few)
    assert found.as_dict()["nominal_collision_rate"] == 0.0
'''


@dataclass(frozen=True, eq=False)
class Explanation:
    """What tells two cars apart, by their names.

    Attributes:
        hits: name of the car that hits.
        misses: name of the car that does not.
        trial: the smallest trial that shows it; None: none was found.
        controller: what the car that hits is called where it is driven again; empty: as in the trial.
    """

    hits: str
    misses: str
    trial: DistinguishingTrial | None
    controller: str = ""

    @property
    def text(self) -> str:
        """What tells them apart, in sentences."""
        trial = self.trial
        if trial is None:
            return f"No trial was found in which {self.hits} hits and {self.misses} does not."
        return (
            f"{self.hits} hits a road user {trial.hit.distance:.2f} m from safe trajectory {trial.number} at "
            f"{trial.hit.impact_speed:.1f} m/s, {self.misses} does not. Both drive alike until {trial.parts_at:.2f} s; "
            f"the hit is at {trial.hits.impact_time:.2f} s. Nothing smaller was found."
        )

    @property
    def folder(self) -> str:
        """Name of the folder with its files, in that of the comparison."""
        return "_".join(
            re.sub(r"[^\w.-]+", "_", name).strip("_") for name in (self.hits, "hits", self.misses, "misses")
        )

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        found = self.trial and {"folder": self.folder, **self.trial.as_dict()}
        return {"hits": self.hits, "misses": self.misses, **(found or {"folder": None})}

    def _car(self, trial: DistinguishingTrial) -> str:
        """Return what the car that hits is called; a file below this folder by its path from here."""
        return from_here(self.controller or trial.hits.episode.controller)

    def command(self, out: Path) -> str:
        """Return the command that rates the car that hits on this trial alone; empty where there is none."""
        if self.trial is None:
            return ""
        episode, folder = self.trial.hits.episode, out / self.folder
        words = [program(), "assess", "--controller", self._car(self.trial)]
        words += ["--multiplier", f"{episode.multiplier!r}"] if episode.car.has_multiplier else []
        words += ["--scenario", str(folder / SCENARIO_FILE), "--safe", str(folder / TRAJECTORY_FILE)]
        words += ["--safe-count", "1", "--kamikaze-count", "1", "--collision-runs", "1", "--margin-limit", "0"]
        words += ["--adversary-model", "generic", "--behaviour", "none"]
        return shlex.join([*words, "--seed", str(episode.seed)])

    def write(self, out: Path) -> None:
        """Write scenario, trajectory, a test for pytest and pictures into a folder of its own."""
        if self.trial is None:
            return
        trial, episode, folder = self.trial, self.trial.hits.episode, out / self.folder
        assert episode.safe_trajectory is not None
        folder.mkdir()
        write_trial(folder, trial.scenario, episode.safe_trajectory)
        car = repr(self._car(trial)) + (f", multiplier={episode.multiplier!r}" if episode.car.has_multiplier else "")
        text = _TEST.format(deviation=trial.hit.distance, seed=episode.seed, car=car)
        (folder / "test_hit.py").write_text(text, encoding="utf-8")
        for log, name, file in ((trial.hits, self.hits, "hits.png"), (trial.misses, self.misses, "misses.png")):
            save_episode(folder / file, _shown(trial, log, name))
        save_picture(_side_by_side(trial, self.hits, self.misses), folder / "side_by_side.png")


def _shown(trial: DistinguishingTrial, log: EpisodeLog, name: str) -> ShownEpisode:
    step, car, collided = trial.scenario.time_step, log.car, log.outcome == Outcome.COLLISION
    times = step * np.arange(len(log.adversary), dtype=np.float64)
    if collided:
        car, times[-1] = until_contact(car, log.impact_time / step), log.impact_time
    ended = f"hit at {log.impact_speed:.1f} m/s" if log.hit else "no hit"
    title = f"{name}: {ended}, {trial.hit.distance:.2f} m from safe trajectory {trial.number}"
    return ShownEpisode(title, trial.scenario, trial.safe, log.trajectory.positions, car, times, collided)


def _side_by_side(trial: DistinguishingTrial, hits: str, misses: str) -> Figure:
    """Return speed, acceleration and gap of both cars over time."""
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    for log, name, colour, style in (
        (trial.hits, hits, palette.KAMIKAZE, "-"),
        (trial.misses, misses, palette.SAFE, "--"),
    ):
        shown = _shown(trial, log, name)
        times, speed = shown.times, shown.car[:, 3]
        fine = np.linspace(0.0, float(times[-1]), 200)
        panels[0].plot(times, speed, color=colour, ls=style, label=f"{name}{', hits' if log.hit else ''}")
        panels[1].stairs(np.diff(speed) / np.diff(times), times, baseline=None, color=colour, ls=style, lw=1.5)
        panels[2].plot(fine, shown.distances(fine)[0], color=colour, ls=style)
    for axes, label in zip(panels, ("speed (m/s)", "acceleration (m/s²)", "gap (m)"), strict=True):
        axes.axvline(trial.parts_at, color=palette.BEHIND, lw=1.0)
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    panels[0].legend(frameon=False)
    panels[2].set_xlabel("time (s); grey: until then both drive alike")
    return figure
