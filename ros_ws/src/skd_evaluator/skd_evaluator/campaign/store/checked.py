"""A result is believed as far as its files are what was written, and its figures follow from its episodes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_sim.choices.simulators import WORLD, is_own_world
from skd_sim.encounter.scenario import scenario_from_dict
from skd_sim.episode.episode import Episode, Mode
from skd_sim.episode.randomness import Role, generator
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.simulation.world import first_car_state

from skd_evaluator.campaign.judge.figure_table import AT_THE_TOP
from skd_evaluator.campaign.plan.options import RECORDED
from skd_evaluator.campaign.store.manifest import MANIFEST, check_unchanged
from skd_evaluator.campaign.store.rebuilt import Contradiction, can_be_rebuilt, recompute
from skd_evaluator.campaign.store.result_file import ASSESSMENT, understood
from skd_evaluator.campaign.store.stored_episodes import EPISODES, StoredEpisodes

_SHOWN = 3
_ROUNDING = 1e-6
"""m, m/s: far more than another processor rounds otherwise, and less than any figure shows."""
_OURS = ("skd", "skd_evaluator.assess")
"""First words of commands that start the simulator themselves."""


class Starts(NamedTuple):
    """Episodes whose car does not start as the seed and the scenario of their result have it.

    Attributes:
        line: how many there are, and one of them.
        refused: whether they ran in SKD's own world, as the result says, and so cannot have started like that.
    """

    line: str
    refused: bool


def check_files(folder: Path) -> bool:
    """See that the files that a result is read from are what was written; return whether a manifest says so.

    Raises:
        UsageError: one is not.
    """
    return check_unchanged(folder, (ASSESSMENT, EPISODES))


def check_result(folder: Path, figures: Mapping[str, Any], stored: StoredEpisodes, *, manifest: bool) -> list[str]:
    """See that the figures of a result follow from its episodes; return what is to be said of it, a line each.

    So have the starts of its episodes to follow from its seed and its scenario. A result without a manifest is of an
    older version, which need not have computed everything in the same way: there only the figures that everybody looks
    at first are refused, and that others differ is said. What else it says is believed, and that is said, too.

    Args:
        folder: of the result.
        figures: content of its assessment.json.
        stored: its episodes.
        manifest: whether it has one.

    Raises:
        UsageError: a figure contradicts the episodes, or their starts contradict the scenario.
    """
    old = not can_be_rebuilt(stored)
    if old:
        if manifest:
            raise UsageError(
                f"{folder / EPISODES}: is of an older version than {MANIFEST} beside it, which was not written with it"
            )
        found: tuple[Contradiction, ...] = ()
    else:
        with understood(folder / ASSESSMENT):
            found = recompute(figures, stored).contradict
    if not manifest:  # what an older version did not have it cannot have got wrong
        found = tuple(one for one in found if not one.missing or one.name.partition(".")[0] in figures)
    refused = found if manifest else tuple(one for one in found if _is_firm(one.name) and one.is_of_numbers)
    if refused:
        shown = "; ".join(map(str, refused[:_SHOWN]))
        more = f"; {len(refused) - _SHOWN} more do not follow" if len(refused) > _SHOWN else ""
        raise UsageError(
            f"{folder / ASSESSMENT}: {shown}{more}: they are not of one assessment; skd verify {folder} lists all"
        )
    said = []
    starts = starts_that_differ(folder, figures, stored)
    if starts is not None:
        if starts.refused:
            raise UsageError(starts.line)
        said.append(starts.line)
    if found:
        said.append(
            f"{folder}: {len(found)} entries are not what this version computes from its episodes (as {found[0]}), and "
            "it has no manifest: it is of an older version, or was changed; skd verify lists them"
        )
    elif not manifest:
        what = "deformation and margin" if old else "figures"
        said.append(
            f"{folder}: has no {MANIFEST}: nothing but its {what} and the starts of its episodes was checked; skd "
            "verify checks what else follows from the seed"
        )
    return said


def starts_that_differ(folder: Path, figures: Mapping[str, Any], stored: StoredEpisodes) -> Starts | None:
    """Return where episodes, or ways of margins, start otherwise than in SKD's own world; None: nowhere.

    Nor does it say anything of episodes of another simulator.

    The world draws the car's start from the seed, so a scenario with another start, or another seed, is found here.

    Args:
        folder: of the result.
        figures: content of its assessment.json.
        stored: its episodes.

    Raises:
        UsageError: its scenario is none, or φ does not go with it.
    """
    with understood(folder / ASSESSMENT):
        if not is_own_world(str((figures.get("options") or {}).get("simulator", WORLD))):
            return None
        scenario, seed = scenario_from_dict(figures["scenario"], f"scenario in {ASSESSMENT}"), int(figures["seed"])
        phis = [Trajectory(one, stored.time_step, "") for one in stored.safe]
        attempts = [Episode(scenario, Mode.REPLAY, seed, 0, safe_trajectory=phi) for phi in phis]
        gaps = [one.start_gap for one in attempts]
        far = np.zeros(len(stored))
        for number, driven in enumerate(stored.car):
            draws = generator(seed, int(stored.episode_id[number]), Role.START)
            car = first_car_state(scenario, gaps[stored.safe_index[number]], draws)
            if np.isfinite(driven[0]).all():  # of one that was aborted before it began nothing is known
                far[number] = np.abs(driven[0] - (car.x, car.y, car.speed)).max()
        ours = figures.get("safe") != RECORDED and _command(figures) in _OURS
    for index, (attempt, ways) in enumerate(zip(attempts, stored.margin_ways, strict=False)):
        for way in ways:
            off = math.dist(way.positions[0], attempt.start)
            if off > _ROUNDING:
                return Starts(
                    f"{folder / EPISODES}: the way of the margin of attempt {way.attempt} of safe trajectory {index} "
                    f"begins {off:.3g} m from where everybody starts there",
                    ours,
                )
    wrong = np.flatnonzero(far > _ROUNDING)
    if not wrong.size:
        return None
    worst = int(np.argmax(far))
    others = "the seed, the scenario" if ours else "the simulator, the seed, the scenario"
    return Starts(
        f"{folder / ASSESSMENT}: in {wrong.size} of {len(stored)} episodes the car does not start as its seed and "
        f"scenario have it (by {far[worst]:.3g} m or m/s in episode {stored.episode_id[worst]}): {others} or the "
        "episodes are others",
        ours,
    )


def _command(figures: Mapping[str, Any]) -> str:
    """Return the first word of the command that made a result; empty where it does not say."""
    return str((figures.get("provenance") or {}).get("command", "")).partition(" ")[0]


def _is_firm(name: str) -> bool:
    """Return whether a figure is one that means the same in every version."""
    row = AT_THE_TOP.get(name.partition(".")[0])
    return row is not None and row.firm
