"""What no state of an episode tells: what counts as a hit, what a miss counts as, and that an episode was aborted."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bag_forge import EPISODE, Sent, changed
from forging import each
from skd_evaluator.bags.logs import look_through
from skd_evaluator.bags.validation import Damage
from skd_evaluator.campaign.store.verification import verify
from skd_evaluator.cli.commands.verify import with_episodes
from skd_sim.episode.episode import Mode, Outcome


def test_a_scenario_of_ours_that_judges_otherwise_is_named(
    sent: list[list[Sent]], recorded: Callable[..., Path], replay: Callable[..., Any]
) -> None:
    """With η_max doubled in all episodes the mean deformation was 3.80 m in place of 2.37 m, without a word."""

    def edit(one: Any) -> Any:
        scenario = json.loads(one.scenario)
        scenario["eta_max"] *= 2.0
        scenario["collision"]["hit_speed"] += 1.0
        return changed(one, "scenario", json.dumps(scenario))

    done = replay(recorded([each(one, [EPISODE], edit) for one in sent]))
    (line,) = done.result["warnings"]
    assert line.startswith(
        "the scenario is called crossing, but judges otherwise than SKD's: η_max (m) is 10 and not 5"
    )
    assert "collision.hit_speed (m/s) is" in line
    assert line in with_episodes(verify(done.path)).remarks  # of the result, too


def test_a_hit_of_a_result_that_is_called_aborted_is_found_by_its_states(
    sent: list[list[Sent]], recorded: Callable[..., Path], replay: Callable[..., Any]
) -> None:
    """Hits along φ counted for nothing, and `skd verify` was fine."""
    file = replay(recorded(sent)).path / "episodes.npz"
    with np.load(file) as archive:
        arrays = {name: archive[name] for name in archive.files}
    (hit, *_) = np.flatnonzero((arrays["outcome"] == Outcome.COLLISION) & (arrays["mode"] != Mode.SAFE))
    arrays["outcome"][hit] = Outcome.ABORTED
    arrays["impact_time"][hit] = arrays["impact_speed"][hit] = math.nan
    for reason, refused in (("no answer: silent", True), ("other: the stack fell over", False)):
        arrays["reason"] = arrays["reason"].astype("U40")
        arrays["reason"][hit] = reason
        np.savez(file, **arrays)
        damage = Damage(skip=True)
        look_through(file, damage)
        assert any("by its states it had come to its end" in line for line in damage.left_out) == refused
        assert any("1 of them had come to their end" in line for line in damage.warnings)
