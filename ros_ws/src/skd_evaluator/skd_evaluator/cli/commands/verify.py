"""`skd verify`: whether results are unchanged, and whether their figures follow from their episodes."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from skd_sim.encounter.scenario import scenario_from_dict
from skd_sim.episode.episode import Mode
from skd_sim.errors import UsageError
from skd_sim.inputs.printable import one_line

from skd_evaluator.bags.completeness import missing_episodes
from skd_evaluator.bags.logs import look_through
from skd_evaluator.bags.replay import judged_otherwise
from skd_evaluator.bags.validation import Damage
from skd_evaluator.campaign.store.result_file import ASSESSMENT, understood
from skd_evaluator.campaign.store.stored_episodes import EPISODES, StoredEpisodes
from skd_evaluator.campaign.store.verification import Verified, folders_below, verify
from skd_evaluator.cli.output import print_json
from skd_evaluator.margin.again import margins_again
from skd_evaluator.ncap.verification import with_regulator
from skd_evaluator.report.terminal import counted

_SHOWN = 20


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    folders = [folder for path in arguments.paths for folder in folders_below(path)]
    found = [with_regulator(with_episodes(verify(folder))) for folder in dict.fromkeys(folders)]
    fine = all(one.fine for one in found)
    if arguments.json:
        print_json({"fine": fine, "results": [one.as_dict() for one in found]})
        return 0 if fine else 1
    for one in found:
        for line in _lines(one):
            print(one_line(line))
    return 0 if fine else 1


def with_episodes(found: Verified) -> Verified:
    """Return what was found, whether each episode can have happened, and whether the margins are those of SKD's cars.

    See `skd_evaluator.bags.validation` and `skd_evaluator.margin.again`.
    """
    read, found = found.read, replace(found, read=None)  # which of many results would take much memory
    if found.problems or read is None:
        return found
    damage, (figures, stored) = Damage(skip=True), read
    try:
        with understood(found.folder / ASSESSMENT):
            count = look_through(found.folder / EPISODES, damage)
            margins = margins_again(found.folder, figures, stored)
            missing = _missing(stored)
            judged = judged_otherwise(scenario_from_dict(figures["scenario"], f"scenario in {ASSESSMENT}"))
    except UsageError as error:
        return replace(found, problems=(*found.problems, str(error)))
    remarks = [*found.remarks, f"{counted(count, 'episode')} can have happened: what follows from the seed is so"]
    if count:
        remarks += damage.warnings
    remarks += [*missing, *judged]
    if margins.remark and not margins.problems:
        remarks.append(margins.remark)
    problems = (*found.problems, *damage.left_out, *margins.problems)
    return replace(found, problems=problems, remarks=tuple(remarks))


def _missing(stored: StoredEpisodes) -> list[str]:
    """Return which attempts are not there although later ones are, a line each; a replay may have left them out."""
    kamikaze = stored.mode == Mode.KAMIKAZE
    runs = stored.episode_id[stored.mode == Mode.REPLAY].tolist()
    lines: list[str] = []
    for objective in np.unique(stored.objective[kamikaze]).tolist():
        own = stored.episode_id[kamikaze & (stored.objective == objective)].tolist()
        which = f" of objective {objective}"
        lines += missing_episodes([*own, *runs], {}, wanted=0, left_out=True, which=which)
    return [line.replace("no recording has", "it has no") for line in dict.fromkeys(lines)]


def _lines(one: Verified) -> list[str]:
    lines = [f"{one.folder}: {'fine' if one.fine else 'NOT FINE'}"]
    if one.files is not None:
        lines.append(f"  {counted(len(one.files.same), 'file')} as written")
        for what, names in (
            ("changed since it was written", one.files.changed),
            ("gone", one.files.missing),
            ("not of this result", one.files.others),
        ):
            lines += _some([f"  {name}: {what}" for name in names])
    if one.unknown is not None:
        lines.append(f"  {counted(len(one.agree), 'figure')} recomputed, and as said")
    lines += _some([f"  contradicted: {line}" for line in one.contradict])
    lines += _some([f"  wrong: {line}" for line in one.problems])
    lines += [f"  not recomputed ({reason}): {', '.join(names)}" for reason, names in (one.unknown or {}).items()]
    return [*lines, *(f"  {line}" for line in one.remarks)]


def _some(lines: list[str]) -> list[str]:
    rest = len(lines) - _SHOWN
    return [*lines[:_SHOWN], f"  … and {rest} more"] if rest > 0 else lines
