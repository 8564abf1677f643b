"""What an assessment or an episode leaves on disk."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from skd_sim.world.episode import EpisodeLog

from skd_evaluator.assessment.files.result_folder import ResultFolder, write_json
from skd_evaluator.assessment.files.results import episode_summary, write_assessment
from skd_evaluator.assessment.judge.assessment import Assessment
from skd_evaluator.assessment.judge.rating import Rating
from skd_evaluator.assessment.run.workers import available_workers, in_background


def fill(folder: Path, rating: Rating, *, may_fork: bool = False) -> None:
    """Write everything that an assessment leaves on disk.

    Args:
        folder: folder that is filled.
        rating: rating of the car.
        may_fork: whether another process may draw some of the pictures: not where other threads run, as those of ROS 2.
    """
    from skd_evaluator.report.pictures import save_trajectories  # slow to import, and needed only now

    (name, first), *others = picture_names(rating).items()

    def draw_the_others() -> None:
        for other, assessment in others:
            save_trajectories(folder / other, rating, assessment)
        if rating.vulnerability is not None:
            from skd_evaluator.report.curves import save_vulnerability, shown_curve

            save_vulnerability(folder / "vulnerability.png", [shown_curve(rating.as_dict())])

    with ExitStack() as stack:
        forks = may_fork and available_workers() > 1
        drawn = stack.enter_context(in_background(draw_the_others)) if forks else lambda: False
        write_assessment(folder, rating)
        save_trajectories(folder / name, rating, first)
        if not drawn():
            draw_the_others()


def picture_names(rating: Rating) -> dict[str, Assessment]:
    """Return the file of each picture of trajectories: `trajectories.png` shows the kamikazes that rank the car."""
    first = rating.for_deviation
    others = [one for one in rating.assessments if one is not first]
    return {"trajectories.png": first, **{f"trajectories_{one.plan.objective}.png": one for one in others}}


def fill_episode(folder: Path, log: EpisodeLog) -> None:
    """Write what a single episode leaves on disk beside its bag."""
    write_json(folder / "episode.json", episode_summary(log))


def save_with_scratch(out: ResultFolder, scratch: Path, write: Callable[[Path], None]) -> str | None:
    """As `write_with_scratch`, but return why it failed; see `ResultFolder.save`."""
    return out.save(partial(_write_all, scratch, write))


def write_with_scratch(out: ResultFolder, scratch: Path, write: Callable[[Path], None]) -> None:
    """Write results, and beside them the bags and logs that are in `scratch`."""
    out.write(partial(_write_all, scratch, write))


def _write_all(scratch: Path, write: Callable[[Path], None], folder: Path) -> None:
    write(folder)
    for part in scratch.iterdir():
        if any(part.iterdir()):
            part.rename(folder / part.name)
