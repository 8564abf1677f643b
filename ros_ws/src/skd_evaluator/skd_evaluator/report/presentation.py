"""What an assessment or an episode leaves on disk, and the line that sums up an episode."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from skd_sim.world.episode import EpisodeLog, Outcome

from skd_evaluator.assessment.assessment import Assessment, ObjectiveResult
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.files.results import episode_summary, write_assessment
from skd_evaluator.assessment.run.workers import available_workers, in_background


def episode_line(log: EpisodeLog) -> str:
    """Return how an episode ended, in a few words."""
    impact, name = "", log.outcome.name.lower()
    if log.outcome == Outcome.TIMEOUT:
        name = "no collision until the time limit"
    elif log.outcome == Outcome.COLLISION:
        impact = f" after {log.impact_time:.2f} s at {log.impact_speed:.2f} m/s"
    return f"{name}{impact}; {len(log.adversary) - 1} ticks"


def fill(folder: Path, assessment: Assessment, *, may_fork: bool = False) -> None:
    """Write everything that an assessment leaves on disk.

    Args:
        folder: folder that is filled.
        assessment: assessment of the car.
        may_fork: whether another process may draw some of the pictures: not where other threads run, as those of ROS 2.
    """
    from skd_evaluator.report.pictures import save_trajectories  # slow to import, and needed only now

    def draw() -> None:
        for name, part in picture_names(assessment).items():
            save_trajectories(folder / name, assessment, part)

    with ExitStack() as stack:
        forks = may_fork and available_workers() > 1
        drawn = stack.enter_context(in_background(draw)) if forks else lambda: False
        write_assessment(folder, assessment)
        if assessment.vulnerability is not None:  # in this process: one forked from a user of Vega waits for ever
            from skd_evaluator.report.charts import ChartedCar, save_vulnerability

            figures = assessment.as_dict()
            car = ChartedCar(str(figures["car"]), figures, curves=figures["vulnerability_curve"])
            save_vulnerability(folder / "vulnerability.png", [car])
        if not drawn():
            draw()


def picture_names(assessment: Assessment) -> dict[str, ObjectiveResult]:
    """Return the file of each picture of trajectories: `trajectories.png` shows the kamikazes that rank the car."""
    first = assessment.for_deviation
    others = [one for one in assessment.results if one is not first]
    return {"trajectories.png": first, **{f"trajectories_{one.plan.objective}.png": one for one in others}}


def fill_episode(folder: Path, log: EpisodeLog) -> None:
    """Write what a single episode leaves on disk beside its bag."""
    write_json(folder / "episode.json", episode_summary(log))


def with_scratch(scratch: Path, write: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return what writes results, and moves the bags and logs that are in `scratch` beside them."""

    def write_all(folder: Path) -> None:
        write(folder)
        for part in scratch.iterdir():
            if any(part.iterdir()):
                part.rename(folder / part.name)

    return write_all
