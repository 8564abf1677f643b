"""`skd behaviour fit`: how people deviate from the way that they intend, from people who were tracked."""

from __future__ import annotations

import argparse
import json
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

from rich.table import Table
from skd_sim.errors import UsageError
from skd_sim.scenario.road_user import ROAD_USERS

from skd_evaluator.bags.checks import Damage
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import print_json
from skd_evaluator.metrics.behaviour.model import FILE_NAME, MEANINGS, Behaviour, write_behaviour
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.terminal import narrow_table, print_table, say_damage
from skd_evaluator.risk.behaviour.fit import HORIZONS, LEAST_TRACKS, QUANTILES, behaviour_of, fit_behaviour
from skd_evaluator.risk.behaviour.tracks import TIME_STEP, WITHIN, Tracked, Validation, folds_of, read_tracks, validate

PICTURE = "behaviour.png"
VALIDATION = "validation.json"


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    begin = time.perf_counter()
    if arguments.kind not in ROAD_USERS:
        raise UsageError(f"--kind must be one of {', '.join(ROAD_USERS.names())}; got {arguments.kind!r:.40}")
    out = result_folder(arguments)
    damage = Damage(skip=arguments.skip_damaged)
    tracks = read_tracks(arguments.paths, damage, arguments.kind)
    say_damage("behaviour", damage)
    check_enough(tracks)
    with progress_bar(quiet=arguments.quiet) as progress:
        validation = validate(tracks, lambda done, of: progress("fits without a part", done, of))
        fit = fit_behaviour([one.positions for one in tracks], TIME_STEP)
    recordings = len({one.recording for one in tracks})
    source = f"fitted to {fit.tracks} tracks of {recordings} recordings"
    behaviour = behaviour_of(fit, arguments.name, arguments.kind, arguments.description or source, source)
    problem = out.save(partial(_fill, behaviour, validation, tracks))
    if problem:
        print(f"skd behaviour: {problem}", file=sys.stderr)
    if validation.worst > WITHIN:
        print(
            f"skd behaviour: warning: a quantile of people held out is {100.0 * validation.worst:.0f} % off, more than "
            f"{100.0 * WITHIN:.0f} %: they walk otherwise than the others, or otherwise than the model can",
            file=sys.stderr,
        )
    if arguments.json:
        print_json({**behaviour.as_dict(), "validation": validation.as_dict()})
        return 1 if problem else 0
    print(f"{fit.tracks} tracks of {recordings} recordings, {fit.steps} ticks")
    print_table(parameter_table(behaviour))
    print_table(validation_table(validation))
    seconds = f"{time.perf_counter() - begin:.1f} s"
    print(seconds if problem else f"{seconds}; behaviour model in {out.path / FILE_NAME}, picture in {PICTURE}")
    return 1 if problem else 0


def check_enough(tracks: list[Tracked]) -> None:
    """Refuse tracks of which too few are left when a part is held out.

    Raises:
        UsageError: it is so.
    """
    by, folds = folds_of(tracks)
    left = min(len(folds) - folds.count(fold) for fold in set(folds))
    if left < LEAST_TRACKS:
        raise UsageError(
            f"{len(tracks)} tracks, of which {left} are left when those of one {by} are held out; a behaviour model "
            f"needs at least {LEAST_TRACKS}"
        )


def _fill(behaviour: Behaviour, validation: Validation, tracks: list[Tracked], folder: Path) -> None:
    from skd_evaluator.report.fit_picture import save_behaviour  # slow to import, and needed only now

    write_behaviour(folder / FILE_NAME, behaviour)
    said = json.dumps(validation.as_dict(), indent=2)
    (folder / VALIDATION).write_text(f"{said}\n", encoding="utf-8")
    ways = [one.positions for one in tracks]
    tables = (validation.recorded, validation.predicted)
    save_behaviour(folder / PICTURE, ways, validation.example, HORIZONS, QUANTILES, tables)


def parameter_table(behaviour: Behaviour) -> Table:
    """Return the table of a model's parameters."""
    table = Table(title=f"Behaviour model {behaviour.name} ({behaviour.kind})", title_justify="left")
    for name in ("", "value", "95 % interval", "source"):
        table.add_column(name, justify="right" if name in ("value", "95 % interval") else "left")
    for name, one in behaviour.parameters.items():
        unit = f" ({MEANINGS[name].unit})" if MEANINGS[name].unit else ""
        interval = "—" if one.interval_95 is None else "[{:.3g}, {:.3g}]".format(*one.interval_95)
        table.add_row(f"{name}{unit}", f"{one.value:.3g}", interval, one.source)
    return table


def validation_table(validation: Validation) -> Table:
    """Return the table of how well people who were held out are predicted."""
    table = narrow_table(
        f"Residual of constant velocity (m) of people held out, by {validation.by}, {validation.folds} parts in turn"
    )
    for name in ("horizon (s)", "quantile", "recorded", "predicted", "ratio"):
        table.add_column(name, justify="right")
    rows: list[dict[str, Any]] = validation.as_dict()["residuals"]
    for row in rows:
        ratio = row["predicted"] / row["recorded"]
        shown = f"{ratio:.2f}" if abs(ratio - 1.0) <= WITHIN else f"[red]{ratio:.2f}[/]"
        quantile = f"{100.0 * row['quantile']:g} %"
        table.add_row(f"{row['horizon']:g}", quantile, f"{row['recorded']:.3f}", f"{row['predicted']:.3f}", shown)
    return table
