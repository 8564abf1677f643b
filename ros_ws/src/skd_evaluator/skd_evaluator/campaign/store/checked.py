"""A result is believed as far as its files are what was written, and its figures follow from its episodes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError

from skd_evaluator.campaign.judge.figure_table import AT_THE_TOP
from skd_evaluator.campaign.store.manifest import MANIFEST, check_unchanged
from skd_evaluator.campaign.store.rebuilt import can_be_rebuilt, recompute
from skd_evaluator.campaign.store.result_file import ASSESSMENT, understood
from skd_evaluator.campaign.store.stored_episodes import EPISODES, StoredEpisodes

_SHOWN = 3


def check_files(folder: Path) -> bool:
    """See that the files that a result is read from are what was written; return whether a manifest says so.

    Raises:
        UsageError: one is not.
    """
    return check_unchanged(folder, (ASSESSMENT, EPISODES))


def check_result(
    folder: Path, figures: Mapping[str, Any], stored: StoredEpisodes, *, manifest: bool, former: bool
) -> list[str]:
    """See that the figures of a result follow from its episodes; return what is to be said of it, a line each.

    A result without a manifest is of an older version, which need not have computed everything in the same way: there
    only the figures that everybody looks at first are refused, and that others differ is said.

    Args:
        folder: of the result.
        figures: content of its assessment.json, under the keys of today.
        stored: its episodes.
        manifest: whether it has one.
        former: whether it is of before the margin, when its figures had other meanings.

    Raises:
        UsageError: a figure contradicts the episodes.
    """
    if former or not can_be_rebuilt(stored):
        if manifest:
            raise UsageError(
                f"{folder / EPISODES}: is of an older version than {MANIFEST} beside it, which was not written with it"
            )
        return []
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
    if not found:
        return []
    return [
        f"{folder}: {len(found)} entries are not what this version computes from its episodes (as {found[0]}), and it "
        "has no manifest: it is of an older version, or was changed; skd verify lists them"
    ]


def _is_firm(name: str) -> bool:
    """Return whether a figure is one that means the same in every version."""
    row = AT_THE_TOP.get(name.partition(".")[0])
    return row is not None and row.firm
