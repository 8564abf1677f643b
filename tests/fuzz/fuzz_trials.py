"""Readers of what stands beside simulations: trials and their recordings, behaviour models, results of protocols."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from skd_evaluator.bags.acceptance import Damage
from skd_evaluator.fusion.measured import Recorder
from skd_evaluator.fusion.table import read_trials
from skd_evaluator.fusion.trial import Trial
from skd_evaluator.measure.behaviour.model import load_behaviour
from skd_evaluator.ncap.result import read_ncap
from skd_evaluator.risk.behaviour.tracks import read_tracks
from skd_sim.encounter.scenario import Scenario, load_scenario


@cache
def _crossing() -> Scenario:
    return load_scenario("crossing")


def walk() -> np.ndarray:
    """Return the φ of which recorded trials are, m at ticks."""
    return np.column_stack([-3.5 + 0.42 * np.arange(17), np.zeros(17)])


def trials_table(data: bytes, folder: Path) -> None:
    """Read a table of trials; its recordings are none."""
    (folder / "trials.csv").write_bytes(data)
    read_trials(folder / "trials.csv", lambda path, trial: trial)


def recorded_trial(data: bytes, folder: Path) -> None:
    """Measure a trial in its recording, a table."""
    (folder / "recorded.csv").write_bytes(data)
    Recorder(_crossing(), {"walk": walk()}).measured(folder / "recorded.csv", Trial("walk", {}, None, "here"))


def behaviour_file(data: bytes, folder: Path) -> None:
    """Read a behaviour model."""
    (folder / "behaviour.yaml").write_bytes(data)
    load_behaviour(folder / "behaviour.yaml").as_dict()


def recorded_people(data: bytes, folder: Path) -> None:
    """Read a track of somebody who crosses."""
    (folder / "track.csv").write_bytes(data)
    read_tracks([folder / "track.csv"], Damage(skip=False))


def protocol_result(data: bytes, folder: Path) -> None:
    """Read the result of a protocol's tests."""
    (folder / "ncap.json").write_bytes(data)
    read_ncap(folder)
