"""Trains the hazard network and writes weights and training record: `scripts/train_hazard_network`."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.hazard.network import HazardNetwork, save_network
from skd_sim.hazard.perception import SCALE, WIDEST_WALKER
from skd_sim.hazard.region import MARGIN, MARGIN_TIME, REACTION_TIME, STANDOFF
from skd_sim.hazard_training.evaluation import calibration, detection, scene_probabilities
from skd_sim.hazard_training.scenes import Scenes, generate_scenes
from skd_sim.hazard_training.training import TrainingOptions, train

SCENARIO = "crossing"
HELD_OUT = 6_000_000  # number of the first held-out episode: none of them is ever trained on
THRESHOLDS = (0.5, 0.9)
WIDE_KEPT = 0.25  # share of wide objects trained on: parked cars are many and easy
WIDTH_COLUMN = 6


@dataclass(frozen=True)
class Recipe:
    """All that determines the weights.

    Attributes:
        seed: seed of every random draw.
        episodes: number of episodes that are simulated for training.
        options: options of the optimiser.
    """

    seed: int = 0
    episodes: int = 12_000
    options: TrainingOptions = field(default_factory=TrainingOptions)


def fit(scenario: Scenario, recipe: Recipe) -> tuple[HazardNetwork, Scenes]:
    """Return the network that a recipe gives, and the scenes that it was trained on."""
    scenes = generate_scenes(scenario, range(recipe.episodes), recipe.seed)
    rng = np.random.Generator(np.random.PCG64(recipe.seed))
    wide = scenes.features[:, WIDTH_COLUMN] > SCALE * WIDEST_WALKER
    kept = ~wide | (rng.random(len(wide)) < WIDE_KEPT)
    return train(scenes.features[kept], scenes.labels[kept], recipe.options, rng), scenes


def digest(network: HazardNetwork) -> str:
    """Return a SHA-256 of the weights."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in network)).hexdigest()


def held_out_figures(network: HazardNetwork, scenes: Scenes) -> dict[str, Any]:
    """Return what the record says of held-out scenes."""
    probabilities = scene_probabilities(network, scenes)
    return {
        "moments": len(scenes.course),
        "on_course": int(scenes.course.sum()),
        "on_course_but_not_visible_in_both_scans": int((scenes.course & ~scenes.visible).sum()),
        "detection": [detection(probabilities, scenes, threshold) for threshold in THRESHOLDS],
        "calibration": calibration(probabilities, scenes),
    }


def make_record(recipe: Recipe, network: HazardNetwork, trained: Scenes, held_out: dict[str, Any]) -> dict[str, Any]:
    """Return the training record."""
    return {
        "recipe": asdict(recipe),
        "scenario": SCENARIO,
        "label": {"reaction_time": REACTION_TIME, "standoff": STANDOFF, "margin": MARGIN, "margin_time": MARGIN_TIME},
        "trained_on": {
            "moments": len(trained.course),
            "objects": len(trained.labels),
            "hazards": int(trained.labels.sum()),
        },
        "weights": {"numbers": sum(part.size for part in network), "sha256": digest(network)},
        "held_out": held_out,
    }


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Train, test on held-out episodes, write, and print the figures."""
    parser = _Parser(
        prog="scripts/train_hazard_network",
        description="Train the hazard network of the controller cal on simulated crossings, and report its precision, "
        "recall and calibration on held-out ones. The same seed gives the same weights.",
    )
    default = Path(__file__).resolve().parent.parent / "hazard"
    parser.add_argument("--out", type=Path, default=default, metavar="DIR", help="folder (default: the package's own)")
    parser.add_argument("--seed", type=_whole, default=0, metavar="N", help="of everything that is drawn (default 0)")
    parser.add_argument(
        "--episodes",
        type=_positive,
        default=Recipe.episodes,
        metavar="N",
        help=f"for training (default {Recipe.episodes})",
    )
    parser.add_argument(
        "--held-out", type=_positive, default=4_000, metavar="N", help="episodes for testing (default 4000)"
    )
    epochs = TrainingOptions.epochs
    parser.add_argument(
        "--epochs", type=_positive, default=epochs, metavar="N", help=f"passes through the data (default {epochs})"
    )
    given = parser.parse_args(arguments)
    if not given.out.is_dir():
        parser.error(f"--out {given.out}: no such folder")
    recipe = Recipe(given.seed, given.episodes, TrainingOptions(epochs=given.epochs))
    begin = time.perf_counter()
    scenario = load_scenario(SCENARIO)
    network, trained = fit(scenario, recipe)
    scenes = generate_scenes(scenario, range(HELD_OUT, HELD_OUT + given.held_out), recipe.seed)
    record = make_record(recipe, network, trained, held_out_figures(network, scenes))
    with tempfile.TemporaryDirectory(dir=given.out) as scratch:  # both files or none
        weights, text = Path(scratch) / "hazard_network.npz", Path(scratch) / "hazard_network.json"
        save_network(network, weights)
        text.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        weights.replace(given.out / weights.name)
        text.replace(given.out / text.name)
    _print(record)
    print(f"{time.perf_counter() - begin:.0f} s; weights and record in {given.out}", file=sys.stderr)
    return 0


def _whole(text: str, low: int = 0) -> int:
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if value < low:
        raise argparse.ArgumentTypeError(f"must be a whole number ≥ {low}, got {text!r}")
    return value


def _positive(text: str) -> int:
    return _whole(text, 1)


def _figure(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.4f}"


def _print(record: dict[str, Any]) -> None:
    held_out = record["held_out"]
    print(f"trained on {record['trained_on']['objects']} objects, sha256 {record['weights']['sha256'][:16]}…")
    for row in held_out["detection"]:
        print(
            f"threshold {row['threshold']}: recall {_figure(row['recall'])} ({row['on_course_detected']} of "
            f"{row['on_course']} on a collision course), precision {_figure(row['precision'])}; with the margin "
            f"{_figure(row['recall_with_margin'])} and {_figure(row['precision_with_margin'])}"
        )
    figures = held_out["calibration"]
    print(f"Brier score {figures['brier']:.4f}, calibration error {figures['expected_calibration_error']:.4f}")


if __name__ == "__main__":
    raise SystemExit(main())
