"""What of an edited setting of a result is found: `python benchmarks/edited_values.py RESULT`.

Changes each value of the scenario in a result's assessment.json, one at a time, and some more that say what ran;
removes the manifest, or writes it anew as a forger would; and reads the result as `skd compare`, `show`, `report` and
`verify` do. A manifest that is kept refuses each of them, so it is not tried. RESULT is a folder of `skd assess`; it is
copied.
"""

from __future__ import annotations

import argparse
import copy
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from skd_evaluator.campaign.store.manifest import MANIFEST, write_manifests
from skd_evaluator.campaign.store.stored_result import read_result
from skd_evaluator.campaign.store.verification import verify
from skd_evaluator.cli.commands.verify import with_episodes
from skd_evaluator.report.html.subjects import read_subjects
from skd_sim.errors import UsageError

OTHERS = {
    "pedestrian": "runner", "basic": "multi_body", "known": "nothing", "learned": "nothing", "synthetic": "own",
}  # fmt: skip
"""Of names that are chosen from a list, others of the list."""
SETTINGS: dict[str, Callable[[dict[str, Any]], object]] = {
    "seed": lambda figures: figures.update(seed=figures["seed"] + 1),
    "controller": lambda figures: figures.update(controller="carla"),
    "multiplier": lambda figures: figures.update(multiplier=(figures["multiplier"] or 1.0) + 0.5),
    "simulations": lambda figures: figures.update(simulations=figures["simulations"] + 1),
    "maximum_distance": lambda figures: figures.update(maximum_distance=1.0),
    "knowledge": lambda figures: figures.update(knowledge=OTHERS.get(figures["knowledge"], "known")),
    "safe": lambda figures: figures.update(safe="own"),
    "options": lambda figures: figures["options"].update(particles=17),
}


def values(section: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield where each value of a scenario stands, and the value."""
    for key, value in section.items():
        if isinstance(value, Mapping):
            yield from values(value, (*path, key))
        else:
            yield (*path, key), value


def another(value: Any) -> Any:
    """Return another value of the same kind."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        return value + 1 if isinstance(value, int) else value * 1.1 or 0.1
    return OTHERS.get(value, f"{value}x") if isinstance(value, str) else value


def edits(figures: Mapping[str, Any]) -> Iterator[tuple[str, Callable[[dict[str, Any]], object]]]:
    """Yield a name and what changes it, for each value."""
    for path, value in values(figures["scenario"]):
        new = another(value)
        if new == value:
            continue

        def change(content: dict[str, Any], path: tuple[str, ...] = path, new: Any = new) -> None:
            section = content["scenario"]
            for key in path[:-1]:
                section = section[key]
            section[path[-1]] = new

        yield ".".join(path), change
    yield from SETTINGS.items()


def read(folder: Path) -> str:
    """Return what becomes of a result that is read, by whoever says most."""
    said = []
    try:
        said = [*read_result(folder).remarks, *read_subjects([folder])[0].remarks]
    except UsageError:
        return "refused"
    if any("not what this version computes" in line for line in said):
        return "said"
    return "line" if said else "read"


def verified(folder: Path) -> str:
    """Return what `skd verify` finds: that it is not fine, something to be said, or nothing."""
    found = with_episodes(verify(folder))
    if not found.fine:
        return "not fine"
    return "said" if any("did not run in" in line or "checked roughly" in line for line in found.remarks) else "fine"


def main() -> None:
    """Print which values end how."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result", type=Path, help="folder of skd assess")
    source = parser.parse_args().result
    original = json.loads((source / "assessment.json").read_text(encoding="utf-8"))
    found: dict[tuple[str, str, str], list[str]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for name, change in edits(original):
            outcomes = []
            for manifest in ("removed", "anew"):
                folder = Path(scratch) / "result"
                shutil.copytree(source, folder)
                content = copy.deepcopy(original)
                change(content)
                (folder / "assessment.json").write_text(json.dumps(content), encoding="utf-8")
                if manifest == "removed":
                    (folder / MANIFEST).unlink(missing_ok=True)
                else:
                    write_manifests(folder)
                outcomes.append(read(folder))
                check = verified(folder)
                shutil.rmtree(folder)
            found.setdefault((outcomes[0], outcomes[1], check), []).append(name)
    print("| without a manifest | with one written anew | skd verify | values |\n|---|---|---|---|")
    for (removed, anew, check), names in sorted(found.items(), key=lambda one: -len(one[1])):
        print(f"| {removed} | {anew} | {check} | {', '.join(names)} |")


if __name__ == "__main__":
    main()
