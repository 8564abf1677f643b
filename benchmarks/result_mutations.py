"""Results that somebody changed, and what their readers do: every mutant in a child of its own, which has a time limit.

    .venv/bin/python benchmarks/result_mutations.py --count 300

A value of assessment.json, an array of episodes.npz, bytes of either or a line of the manifest are changed at random;
the manifest is kept, written anew or removed. `--forged` forges whole episodes, and figures wherever they stand;
`--consistent` so that all files of the result agree (`result_forgeries.py`), and says what `skd verify` finds. Then
the result is read as `compare`, `plan`, `report`, `show` and
`verify` read it. A mutant fails where one ends in anything but a refusal in one line, takes too long, or lets a figure
pass that is another one than before without a word. Options that are not its own go to `skd assess`, as `--scenario`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import multiprocessing
import random
import shutil
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from result_forgeries import mutate_consistently, mutate_sayings, mutate_selection
from result_writers import WRITERS
from skd_evaluator.campaign.store.manifest import MANIFEST, write_manifests
from skd_evaluator.campaign.store.rebuilt import entries_of, recompute
from skd_evaluator.campaign.store.result_file import read_figures
from skd_evaluator.campaign.store.stored_episodes import read_episodes
from skd_evaluator.campaign.store.stored_result import read_result
from skd_evaluator.campaign.store.verification import verify
from skd_evaluator.cli.commands.verify import with_episodes
from skd_evaluator.cli.main import main as skd
from skd_sim.errors import UsageError

LIMIT = 60.0
"""s for one mutant, in a process that shares its machine."""
JUNK: list[Any] = [
    None, True, False, 0, -1, 1e308, -1e-300, 2**63, 2**70, "", "abc", "\x1b[2J", "\u202e", "../x", [], {}, [1], [None],
    [math.nan], math.nan, math.inf, {"a": {"b": 1}}, "9" * 400, -0.5, 1.5,
]  # fmt: skip
ASSESS = (
    "--safe-count", "3", "--kamikaze-count", "4", "--collision-runs", "9", "--simulations", "30", "--workers", "1",
    "--quiet",
)  # fmt: skip


def leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path] if path else []
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, one in items:
        found += leaves(one, (*path, key))
    return found


def mutate_json(folder: Path, draw: random.Random) -> str:
    path = folder / "assessment.json"
    figures = json.loads(path.read_text())
    for _ in range(draw.choice([1, 1, 2])):
        *way, last = draw.choice(leaves(figures))
        inside = figures
        for key in way:
            inside = inside[key]
        old = inside[last]
        if draw.random() < 0.15:
            del inside[last]
            what = f"{last} removed"
        elif draw.random() < 0.5 and isinstance(old, (int, float)) and not isinstance(old, bool):
            inside[last] = draw.choice([old + 1, old * 1.01 + 1e-3, -old, old / 2 + 0.1])
            what = f"{'.'.join(map(str, (*way, last)))} {old!r:.20} → {inside[last]!r:.20}"
        else:
            inside[last] = draw.choice(JUNK)
            what = f"{'.'.join(map(str, (*way, last)))} → {inside[last]!r:.30}"
    path.write_text(json.dumps(figures))
    return f"json: {what}"


def mutate_arrays(folder: Path, draw: random.Random) -> str:
    path = folder / "episodes.npz"
    with np.load(path) as file:
        arrays = {name: file[name].copy() for name in file.files}
    name = draw.choice(sorted(arrays))
    one = arrays[name]
    kind = draw.choice(["value", "value", "value", "type", "cut", "double", "gone", "shape"])
    if kind == "gone":
        del arrays[name]
    elif kind == "type":
        arrays[name] = one.astype(draw.choice(["U5", "f4", "i8", "f8", "?"])) if one.dtype.kind != "U" else np.zeros(3)
    elif kind == "cut":
        arrays[name] = one[:-1] if one.ndim else np.zeros(2)
    elif kind == "double":
        arrays[name] = np.concatenate([one, one]) if one.ndim else np.stack([one, one])
    elif kind == "shape":
        arrays[name] = one[..., None]
    elif one.size:
        flat = one.reshape(-1).copy()
        at = draw.randrange(flat.size)
        if flat.dtype.kind == "U":
            flat = flat.astype("U40")
            flat[at] = draw.choice(["", "x", "\x1b[2J", "no answer: x"])
        elif flat.dtype.kind == "b":
            flat[at] = not flat[at]
        elif flat.dtype.kind == "f":
            flat[at] = draw.choice([math.nan, math.inf, -1.0, 1e300, 0.0, float(flat[at]) + 0.01, float(flat[at]) * 2])
        else:
            info = np.iinfo(flat.dtype)
            flat[at] = draw.choice([0, 1, -1, 5, int(info.max), int(info.min), min(int(info.max), int(flat[at]) + 1)])
        arrays[name] = flat.reshape(one.shape)
    np.savez(path, **arrays)
    return f"npz: {name}, {kind}"


def mutate_bytes(folder: Path, draw: random.Random) -> str:
    path = folder / draw.choice(["assessment.json", "episodes.npz", MANIFEST])
    data = bytearray(path.read_bytes())
    if draw.random() < 0.3:
        data = data[: draw.randrange(len(data))]
    else:
        for _ in range(draw.choice([1, 3])):
            data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    path.write_bytes(data)
    return f"bytes: {path.name}"


def mutate_episodes(folder: Path, draw: random.Random) -> str:
    """Forge whole episodes, so that arrays go together: one is gone, doubled, exchanged, moved, or called another."""
    path = folder / "episodes.npz"
    with np.load(path) as file:
        arrays = {name: file[name].copy() for name in file.files}
    mode, offsets = arrays["mode"], arrays["offsets"]
    rows = [row for row in range(len(mode)) if mode[row] != 0]
    one, other = draw.choice(rows), draw.choice(rows)
    order = list(range(len(mode)))
    kind = draw.choice(["gone", "doubled", "exchanged", "moved", "missed", "faster", "other φ", "turned"])
    if kind == "gone":
        order.remove(one)
    elif kind == "doubled":
        order.insert(one, one)
    elif kind == "exchanged":
        order[one], order[other] = order[other], order[one]
    elif kind == "missed":
        arrays["outcome"][one] = draw.choice([2, 3, 4, 5])
        arrays["impact_time"][one] = arrays["impact_speed"][one] = math.nan
    elif kind == "faster":
        arrays["impact_speed"][one] *= draw.choice([0.5, 1.01, 2.0])
    elif kind == "other φ":
        arrays["safe_index"][one] = (arrays["safe_index"][one] + 1) % (mode == 0).sum()
    elif kind == "moved":
        arrays["positions"][offsets[one] : offsets[one + 1]] += draw.choice([1e-7, 0.01, -0.5])
    else:  # the whole world
        arrays["positions"] = arrays["positions"][:, ::-1].copy()
        arrays["car"] = arrays["car"][:, [1, 0, 2]]
    of_states = [name for name in ("positions", "car", "belief") if name in arrays]
    states = np.concatenate([np.arange(offsets[row], offsets[row + 1]) for row in order])
    lengths = [int(offsets[row + 1] - offsets[row]) for row in order]
    for name, one_array in arrays.items():
        if name in of_states:
            arrays[name] = one_array[states]
        elif one_array.ndim == 1 and len(one_array) == len(mode) and not name.startswith(("margin", "safe_name")):
            arrays[name] = one_array[order]
    arrays["offsets"] = np.concatenate([[0], np.cumsum(lengths)])
    np.savez(path, **arrays)
    return f"episodes: {kind}"


def mutate_figures_alike(folder: Path, draw: random.Random) -> str:
    """Change a number of assessment.json wherever it stands."""
    path = folder / "assessment.json"
    figures = json.loads(path.read_text())

    def value_at(way: tuple[Any, ...]) -> Any:
        inside = figures
        for key in way:
            inside = inside[key]
        return inside

    ways = leaves(figures)
    old = draw.choice([value for way in ways if isinstance(value := value_at(way), float)])
    new = draw.choice([old * 1.001 + 1e-4, old / 2 + 0.1, -old - 1.0])
    count = 0
    for *way, last in ways:
        inside = value_at(tuple(way))
        if isinstance(inside[last], float) and inside[last] == old:
            inside[last], count = new, count + 1
    path.write_text(json.dumps(figures))
    return f"alike: {old} → {new}, {count} times"


MUTATORS = (mutate_json, mutate_json, mutate_arrays, mutate_arrays, mutate_bytes)
FORGERIES = (mutate_episodes, mutate_episodes, mutate_figures_alike)
CONSISTENT = (mutate_consistently, mutate_selection, mutate_sayings)


def said(folder: Path) -> dict[str, Any]:
    """Return the figures that follow from episodes, as a result has them."""
    figures, _ = read_figures(folder)
    names = set(recompute(figures, read_episodes(folder)).agree)
    return {name: value for name, value in entries_of(figures) if name in names}


def read_all(folder: Path, base: Path, scratch: Path, true: dict[str, Any]) -> str:
    """Read a result in every way; return what came of it."""
    refused = 0
    for reader in ("compare", "plan", "report", "verify", "show"):
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as err:
                commands = {
                    "compare": ["compare", str(base), str(folder), "--json", "--out", str(scratch / "compared")],
                    "report": ["report", str(folder), "--out", str(scratch / "report.html")],
                    "verify": ["verify", str(folder)],
                    "plan": ["plan", str(folder), "--width", "0.3"],
                    "show": ["show", str(folder), "--out", str(scratch / "shown")],
                }
                if reader == "verify":
                    verify(folder)
                code = skd(commands[reader])
            if code:
                assert code in (1, 2), code
                assert len(err.getvalue().splitlines()) == (0 if reader == "verify" and code == 1 else 1), (
                    err.getvalue()
                )
                refused += 1
        except UsageError as error:
            assert "\n" not in str(error), error  # noqa: PT017
            refused += 1
    try:
        result = read_result(folder)
    except UsageError:
        return "refused"
    now = dict(entries_of(result.figures))
    passed = [name for name, value in true.items() if not alike(now.get(name), value)]
    if not passed:
        return "read, same figures" if refused <= 1 else "refused by some, same figures"
    return "read, and said" if result.remarks else f"PASSED: {passed[:3]}"


def alike(one: Any, other: Any) -> bool:
    numbers = all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in (one, other))
    return abs(one - other) <= 1e-6 * max(1.0, abs(other)) if numbers else one == other


def child(
    pipe: Any, base: Path, true: dict[str, Any], seed: int, folder: Path, mutators: Sequence[Callable[..., str]]
) -> None:
    draw = random.Random(seed)
    target = folder / "result"
    shutil.copytree(base, target)
    what = draw.choice(mutators)(target, draw)
    manifest = "anew" if mutators is CONSISTENT else draw.choice(["kept", "anew", "anew", "removed"])
    if what != f"bytes: {MANIFEST}" and not what.startswith("manifest:"):
        if manifest == "removed":
            (target / MANIFEST).unlink()
        elif manifest == "anew":
            write_manifests(target)
    try:
        found = read_all(target, base, folder, true)
        if mutators is CONSISTENT and not found.startswith("refused"):
            found = f"{'consistent' if with_episodes(verify(target)).fine else 'found by verify'}: {found}"
    except BaseException as error:
        found = f"TRACEBACK: {type(error).__name__}: {error!s:.300}\n{traceback.format_exc()[-1500:]}"
    pipe.send((f"{what.partition(':')[0]}, manifest {manifest}", what, found))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--forged", action="store_true", help="forge whole episodes, and figures wherever they stand")
    parser.add_argument("--consistent", action="store_true", help="forge so that all files agree")
    parser.add_argument("--written", action="store_true", help="write files as other programs do")
    parser.add_argument("--verbose", action="store_true", help="print every mutant and what became of it")
    given, further = parser.parse_known_args()
    mutators = CONSISTENT if given.consistent else FORGERIES if given.forged else MUTATORS
    mutators = WRITERS if given.written else mutators
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        bases = [scratch / "known", scratch / "two"]
        assert skd(["assess", *ASSESS, *further, "--out", str(bases[0])]) == 0
        assert skd(["assess", *ASSESS, *further, "--multiplier", "0.6", "--curve", "--out", str(bases[1])]) == 0
        truths = [said(base) for base in bases]
        for base, true in zip(bases, truths, strict=True):
            print(read_all(base, bases[0], scratch / "warm", true), f"{len(true)} figures", flush=True)
            shutil.rmtree(scratch / "warm", ignore_errors=True)
        table: dict[str, Counter[str]] = {}
        failures = 0
        fork = multiprocessing.get_context("fork")
        for number in range(given.count):
            folder = scratch / f"{number}"
            folder.mkdir()
            mine, theirs = fork.Pipe()
            at_hand = number % 2
            process = fork.Process(
                target=child, args=(theirs, bases[at_hand], truths[at_hand], given.seed + number, folder, mutators)
            )
            process.start()
            kind, what, found = mine.recv() if mine.poll(LIMIT) else ("hang", "", "HANG")
            if process.is_alive() and found == "HANG":
                process.kill()
            process.join()
            if found.isupper() or found.split(":")[0].isupper():
                failures += 1
            if given.verbose or found.isupper() or found.split(":")[0].isupper():
                print(f"{given.seed + number}: {kind}: {what}: {found}", flush=True)
            table.setdefault(kind, Counter())[found.split(":")[0]] += 1
            shutil.rmtree(folder, ignore_errors=True)
        for kind, counts in sorted(table.items()):
            print(f"{kind}: {dict(counts)}")
        print(f"{given.count} mutants, {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
