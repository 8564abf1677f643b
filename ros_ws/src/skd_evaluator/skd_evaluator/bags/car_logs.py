"""Recordings of a car for learning: from bags, or from the episodes.npz of an assessment or a probe."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from skd_adversary.car_models.observations import RecordedEpisode
from skd_sim.errors import UsageError
from skd_sim.inputs.files import folders_in, read_json
from skd_sim.options.car_and_adversary import AdversaryModel, CarUnderTest
from skd_sim.scenario.road import HEADING_NORTH, right_and_along, road_pose
from skd_sim.scenario.scenario import scenario_from_dict
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode

from skd_evaluator.assessment.files.episodes_npz import EPISODES
from skd_evaluator.assessment.files.episodes_npz import read_episodes as read_arrays
from skd_evaluator.assessment.files.result_folder import check_unchanged
from skd_evaluator.bags.checks import SUMMARIES, Damage, LocatedLog, accept, not_credible_beside
from skd_evaluator.bags.files import holds_recordings, is_recording
from skd_evaluator.bags.read import read_episodes
from skd_evaluator.metrics.aborted import not_credible


def recording_of(log: EpisodeLog) -> RecordedEpisode:
    """Return what an episode's log says about the car."""
    scenario = log.episode.scenario
    # The fit sees every road as a straight one: offsets across it, distances along it.
    line = scenario.road.line
    walked, driven = (right_and_along(line, places[:, :2]) for places in (log.adversary, log.car))
    turned = [heading - road_pose(line, s)[2] for heading, s in zip(log.car[:, 2], driven[:, 1], strict=True)]
    heading = log.car[:, 2] if scenario.road.straight else HEADING_NORTH + np.angle(np.exp(1j * np.array(turned)))
    car = np.column_stack([driven, heading, log.car[:, 3]])
    return RecordedEpisode(walked, car, scenario.time_step, scenario.car.front, scenario.car.rear)


def read_recordings(paths: Sequence[Path], damage: Damage | None = None) -> list[RecordedEpisode]:
    """Return every recorded episode of `paths`: bag folders, files of recordings, episodes.npz, or folders of them.

    An episodes.npz with bags below its folder is not read, for they hold every episode. An episode that is found twice
    counts once.

    Args:
        paths: files and folders in which to look.
        damage: takes note of what is left out and what is to be said; by default whatever is damaged is refused.

    Raises:
        UsageError: a path cannot be read, or holds neither; the logs are of several controllers; or something is
            damaged and must not be left out.
    """
    damage = damage or Damage()
    found: dict[tuple[bytes, bytes], RecordedEpisode] = {}
    cars: dict[str, Path] = {}
    for path in paths:
        for car, recording in _recorded(path, damage):
            cars.setdefault(car, path)
            found.setdefault((recording.adversary.tobytes(), recording.car.tobytes()), recording)
    if len(cars) > 1:
        (one, first), (other, second) = list(cars.items())[:2]
        where = f"both in {first}" if first == second else f"in {first} and in {second}"
        raise UsageError(f"the logs are of several cars: {one} and {other}, {where}; fit them apart")
    return list(found.values())


def _recorded(path: Path, damage: Damage) -> Iterator[tuple[str, RecordedEpisode]]:
    """Yield (controller, recording) of every episode below a path."""
    if not path.exists():
        raise UsageError(f"{path}: no such file or folder")
    if path.is_dir():
        arrays, bags = _arrays_below(path, damage), holds_recordings(path)
        if not bags and not arrays:
            raise UsageError(f"{path}: holds neither recordings nor {EPISODES}; record some with skd probe")
    else:
        bags, arrays = is_recording(path), [path] if path.suffix == ".npz" else []
        if not bags and not arrays:
            raise UsageError(f"{path}: give {EPISODES}, a recording, or a folder of them")
    if bags:
        for line in not_credible_beside(path.rglob("*.mcap*") if path.is_dir() else [path]):
            damage.warn(f"{path}: {line}")
        for episode in read_episodes([path], damage):
            log = episode.log
            yield log.episode.car.label, recording_of(log)
    for file in arrays:
        yield from _read_npz(file, damage)


def _arrays_below(folder: Path, damage: Damage) -> list[Path]:
    """Return each episodes.npz at or below a folder that has no bags below its own."""
    holding = {
        path
        for path, _, files in folders_in(folder, lambda path, why: damage.leave_out(f"{path}: {why}"))
        if EPISODES in files
    }
    return [path / EPISODES for path in sorted(holding) if not holds_recordings(path)]


def _car_of(path: Path) -> tuple[EpisodeSpec, list[str]]:
    """Return what all episodes of an episodes.npz share, from the summary in its folder, and why it is not credible."""
    file = next((path.parent / name for name in SUMMARIES if (path.parent / name).exists()), None)
    if file is None:
        raise UsageError(f"{path}: has no {' or '.join(SUMMARIES)} beside it, which says what car it was")
    try:
        content = read_json(file)
        controller, multiplier = str(content["controller"]), content["multiplier"]
        if multiplier is None and not CarUnderTest(controller).has_multiplier:
            multiplier = 1.0
        model = (content.get("options") or {}).get("adversary_model")
        spec = EpisodeSpec(
            scenario_from_dict(content["scenario"], str(file)),
            Mode.SAFE,
            int(content["seed"]),
            0,
            controller=controller,
            multiplier=float(multiplier),
            adversary_model=AdversaryModel(model) if model else None,
        )
        return spec, not_credible(content.get("warnings") or ())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise UsageError(f"{file}: does not say what car it was ({' '.join(str(error).split())})") from error


def _read_npz(path: Path, damage: Damage) -> Iterator[tuple[str, RecordedEpisode]]:
    """Yield (controller, recording) of every episode in an episodes.npz that can have happened."""
    try:
        check_unchanged(path.parent, [path.name, *(name for name in SUMMARIES if (path.parent / name).exists())])
        car, reasons = _car_of(path)
        logs = _logs_in(path, car)
    except UsageError as error:
        damage.leave_out(str(error))
        return
    for line in reasons:
        damage.warn(f"{path}: {line}")
    for one in accept([LocatedLog(log, str(path), str(path)) for log in logs], damage):
        yield one.log.episode.car.label, recording_of(one.log)


def _logs_in(path: Path, car: EpisodeSpec) -> list[EpisodeLog]:
    """Return the episodes of an episodes.npz, of an assessment or of a probe."""
    stored, step = read_arrays(path.parent, path.name), car.scenario.time_step
    if stored.time_step != step:
        raise UsageError(f"{path}: its time step is {stored.time_step:g} s, that of its scenario {step:g} s")
    try:
        return stored.logs(car)
    except (ValueError, LookupError) as error:
        raise UsageError(f"{path}: {' '.join(str(error).split())}") from error
