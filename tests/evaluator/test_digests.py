"""Campaigns whose every bit is known: `digests.json` holds what they gave when it was written.

A change that means to change trajectories writes the file anew: `python tests/evaluator/test_digests.py`, and says in
CHANGELOG.md what changes. Anything else leaves it alone. The digests are those of one kind of machine: another
processor or another mathematical library may round otherwise, as may another release of numba.
"""

import hashlib
import io
import json
import math
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skd_adversary.car_models.car_model_file import PARAMETERS, CarParameter, FittedCar, ParameterPrior, car_model_text
from skd_evaluator.assessment.files.episodes_npz import write_episodes
from skd_evaluator.assessment.options import OWN, SYNTHETIC
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_sim import AdversaryState, CarState, Mode, Outcome, Scenario, load_scenario
from skd_sim.options.car_and_adversary import Objective
from stages import rate

DIGESTS = Path(__file__).with_name("digests.json")
COLUMNS = ("mode", "safe_index", "outcome", "episode_id", "impact_time", "impact_speed")
CROSSING = load_scenario("crossing")
RECORDED = "recorded"  # stands for a file that the campaign writes first


class BrakesByTime:
    """A car that keeps its speed until the adversary is 1.4 s away, and then brakes with 6 m/s²."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self._front = scenario.car.front

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        gap = adversary.y - car.y - self._front
        return -6.0 if 0.0 <= gap <= 1.4 * car.speed else 0.3 * (8.0 - car.speed)


def a_walk() -> str:
    """A recorded walk: at a pace of its own, drifting and swaying, sampled at 29.97 Hz."""
    seconds = np.arange(0.0, 7.0, 1.0 / 29.97)
    x = -4.1 + 1.37 * seconds
    y = 0.12 * x + 0.2 * np.sin(1.3 * x)
    rows = np.column_stack([seconds, x, y]).tolist()
    return "t,x,y\n" + "".join(f"{row[0]!r},{row[1]!r},{row[2]!r}\n" for row in rows)


def a_fitted_car() -> str:
    """A car learned from logs, as an episode carries it, with every kind of prior."""
    priors = {
        "trigger": ParameterPrior("normal", 9.3, 0.6),
        "deceleration": ParameterPrior("uniform", 3.0, 4.0),
        "deceleration_noise": ParameterPrior("point", 0.1),
        "reaction_delay": ParameterPrior("point", 0.3),
        "cruise_speed": ParameterPrior("point", 25.0 / 3.0),
        "speed_noise": ParameterPrior("normal", 0.05, 0.005),
    }
    parameters = {
        name: CarParameter(
            prior := priors.get(name, ParameterPrior("point", 0.0)), prior.first, 0.0, (prior.first, prior.first)
        )
        for name in PARAMETERS
    }
    car = FittedCar(measure="distance", gate="none", spread="episode", lapse=0.0, parameters=parameters, time_step=0.3)
    return car_model_text(car)


_OWN_CAR = f"{Path(__file__).stem}:BrakesByTime"
_SMALL = Plan(CROSSING, safe_count=2, kamikaze_count=3, collision_runs=6, seed=11, simulations=120)
_RECORDED = replace(_SMALL, scenario=load_scenario("citr_crossing"), safe=RECORDED, safe_count=1)
_FRECHET = Objective.FRECHET
_DEVIATION = Objective.DEVIATION
PLANS = {
    "basic, C = 0.5": replace(_SMALL, multiplier=0.5),
    "basic, C = 1": _SMALL,
    "basic, C = 1.15": replace(_SMALL, multiplier=1.15),
    "basic, C = 0.5, frechet": replace(_SMALL, multiplier=0.5, objective=_FRECHET),
    "basic, C = 1, frechet": replace(_SMALL, objective=_FRECHET),
    "basic, C = 1.15, frechet": replace(_SMALL, multiplier=1.15, objective=_FRECHET),
    "basic, C = 1, recorded": _RECORDED,
    "basic, C = 0.5, recorded": replace(_RECORDED, multiplier=0.5),
    "basic, C = 1.15, recorded": replace(_RECORDED, multiplier=1.15),
    "basic, C = 0.5, recorded, frechet": replace(_RECORDED, multiplier=0.5, objective=_FRECHET),
    "basic, C = 1, recorded, frechet": replace(_RECORDED, objective=_FRECHET),
    "basic, C = 1.15, recorded, frechet": replace(_RECORDED, multiplier=1.15, objective=_FRECHET),
    "carla": replace(_SMALL, controller="carla"),
    "cal": replace(_SMALL, controller="cal", objective=_FRECHET),
    "multi-body": replace(_SMALL, scenario=load_scenario("crossing_multi_body")),
    "a class": replace(_SMALL, controller=_OWN_CAR, safe=OWN),
    "a fitted model": replace(_SMALL, controller=_OWN_CAR, car_model=a_fitted_car()),
    "basic, C = 1.15, deviation": replace(_SMALL, multiplier=1.15, objective=_DEVIATION),
    "carla, deviation": replace(_SMALL, controller="carla", objective=_DEVIATION),
    "a fitted model, deviation": replace(_SMALL, car_model=a_fitted_car(), objective=_DEVIATION, safe=OWN),
    "a fitted model, frechet": replace(_SMALL, car_model=a_fitted_car(), objective=_FRECHET, safe=OWN),
}


def digested(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what the digests are of: φ, the kamikazes that collided and the runs along φ, without their objective.

    A file also holds kamikazes that failed; which those are follows from the ids of the others.
    """
    kept = (arrays["mode"] != Mode.KAMIKAZE) | (arrays["outcome"] == Outcome.COLLISION)
    lengths = np.diff(arrays["offsets"])
    rows = np.repeat(kept, lengths)
    of_rows = {name: arrays[name][rows] for name in ("positions", "car")}
    whole = {"time_step": arrays["time_step"], "offsets": np.cumsum([0, *lengths[kept]], dtype=np.int64)}
    return {**of_rows, **whole, **{name: arrays[name][kept] for name in COLUMNS if name in arrays}}


def digest_of(name: str) -> str:
    """Return the digest of the arrays that episodes.npz of a campaign holds."""
    plan = PLANS[name]
    with InProcessRunner(1) as runner, tempfile.TemporaryDirectory() as folder:
        if plan.safe == RECORDED:
            path = Path(folder) / "walk.csv"
            path.write_text(a_walk(), encoding="utf-8")
            plan = replace(plan, safe=str(path))
        assessment = rate(plan, [plan.objective], safe_trajectories(plan, runner), runner)
    file = io.BytesIO()
    write_episodes(file, assessment)
    file.seek(0)
    digest = hashlib.sha256()
    with np.load(file) as found:
        arrays = digested({key: found[key] for key in found})
        for key in sorted(arrays):
            array = arrays[key]
            digest.update(f"{key} {array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    skd = assessment.results[0].skd.distances.mean
    return f"{digest.hexdigest()[:32]} {'none' if skd is None else skd.hex()}"


@pytest.mark.parametrize("name", PLANS)
def test_every_bit_is_what_it_was(name):
    assert digest_of(name) == json.loads(DIGESTS.read_text(encoding="utf-8"))[name]


def test_each_campaign_is_one_of_its_own():
    """Two that give the same would be one check, and one without a pair would be none."""
    found = json.loads(DIGESTS.read_text(encoding="utf-8"))
    assert set(found) == set(PLANS)
    assert SYNTHETIC in {plan.safe for plan in PLANS.values()}
    assert len(set(found.values())) == len(found)
    for name, digest in found.items():
        skd = float.fromhex(digest.split()[1])
        assert math.isfinite(skd), name
        assert skd > 0.0, name


if __name__ == "__main__":
    sys.path.insert(0, str(DIGESTS.parent))  # where the campaigns find the class
    written = json.dumps({name: digest_of(name) for name in PLANS}, indent=2, ensure_ascii=False)
    DIGESTS.write_text(written + "\n", encoding="utf-8")
