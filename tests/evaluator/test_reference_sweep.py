from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from skd_evaluator.campaign.assessment import Assessment, assess
from skd_evaluator.campaign.plan import Plan, safe_trajectories
from skd_evaluator.campaign.reference_sweep import (
    attempt_deformations,
    equivalent_of,
    fitting,
    load_reference,
    reference_from,
    references_at,
    save_reference,
    shipped_reference,
)
from skd_evaluator.campaign.workers import InProcessRunner
from skd_evaluator.cli.sweep import DENSE
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.errors import UsageError
from skd_sim.objective import Objective
from skd_sim.trajectory import Trajectory

CROSSING = load_scenario("crossing")
SAFE = [
    Trajectory(np.column_stack([np.arange(-3.5, 2.6, 0.75), np.full(9, north)]), CROSSING.time_step, f"φ{north:g}")
    for north in (0.0, 0.5)
]
SMALL = Plan(
    CROSSING, kamikaze_count=4, collision_runs=2, simulations=30, objective=Objective.DEFORMATION, multiplier=0.5
)


def silent(_label: str, _done: int, _total: int) -> None:
    pass


def assessed(multiplier: float, **changes: object) -> Assessment:
    plan = dataclasses.replace(SMALL, multiplier=multiplier, **changes)
    return assess(plan, SAFE, InProcessRunner(1), silent)


@pytest.fixture(scope="module")
def swept() -> list[Assessment]:
    return [assessed(multiplier) for multiplier in (1.4, 0.4, 0.9)]


def changed(**keys: object) -> Scenario:
    """Return the crossing with keys of its sections changed, `section__key`."""
    scenario = CROSSING
    for name, value in keys.items():
        section, _, key = name.partition("__")
        if key:
            value = dataclasses.replace(getattr(scenario, section), **{key: value})
        scenario = dataclasses.replace(scenario, **{section: value})
    return scenario


def test_a_reference_is_kept_whole(swept, tmp_path):
    made = reference_from(swept)
    assert made.multipliers.tolist() == [0.4, 0.9, 1.4]
    save_reference(tmp_path / "reference_recorded.npz", made)
    (read,) = references_at(tmp_path)
    np.testing.assert_array_equal(read.deformations, made.deformations)
    np.testing.assert_array_equal(read.multipliers, made.multipliers)
    assert read.scenario == CROSSING.as_dict()
    assert (read.seed, read.simulations) == (0, 30)
    assert read.mismatch(SMALL, SAFE) is None
    assert fitting([read], SMALL, SAFE) is read


def test_attempts_are_told_by_their_numbers(swept):
    for one in swept:
        per_phi = attempt_deformations(one)
        assert sum(np.nansum(group) for group in per_phi) == pytest.approx(
            one.deformation.mean * one.deformation.attempts
        )
        for group, kamikaze in zip(per_phi, one.kamikaze, strict=True):
            failed = [log.episode.episode_id & 0xFFFF_FFFF for log in kamikaze.misses]
            assert (group[failed] == CROSSING.eta_max).all()


def test_a_car_of_the_sweep_is_found_in_it(swept):
    reference = reference_from(swept)
    for one in swept:
        found, note = equivalent_of(one, reference)
        assert note == ""
        assert found.value == pytest.approx(one.plan.multiplier)  # means that rise are kept by the regression
    assert reference_from(swept[:1] + swept[2:]).equivalent(swept[1]).text == "below 0.9"


@pytest.mark.parametrize(
    ("plan", "said"),
    [
        (dataclasses.replace(SMALL, objective=Objective.PAPER), "objective paper"),
        (dataclasses.replace(SMALL, simulations=1000), "1000"),
        (dataclasses.replace(SMALL, maximum_distance=2.0), "maximum distance"),
        (dataclasses.replace(SMALL, particles=50), "particles 50"),
        (dataclasses.replace(SMALL, scenario=changed(eta_max=4.0)), "eta_max 5.0, this one 4.0"),
        (dataclasses.replace(SMALL, scenario=changed(pedestrian__speed=2.0)), "pedestrian.speed 2.5, this one 2.0"),
        (dataclasses.replace(SMALL, scenario=changed(car__start_speed=5.0)), "car.start_speed"),
    ],
)
def test_what_is_no_reference_is_named(swept, plan, said):
    reference = reference_from(swept, "there.npz")
    assert said in reference.mismatch(plan, SAFE)
    with pytest.raises(UsageError, match="there"):
        fitting([reference], plan)


def test_other_safe_trajectories_have_another_reference(swept):
    reference = reference_from(swept)
    moved = [dataclasses.replace(one, positions=one.positions + np.array([0.0, 1e-3])) for one in SAFE]
    for other in (moved, SAFE[:1], SAFE[::-1]):
        assert "other φ" in reference.mismatch(SMALL, other)


def test_what_is_the_cars_own_may_differ(swept):
    own = changed(name="mine", car__width=1.6, car__deceleration=6.0, sensor=None)
    assert reference_from(swept).mismatch(dataclasses.replace(SMALL, scenario=own), SAFE) is None


def test_without_a_reference_it_is_said_how_one_is_made(swept):
    found, note = equivalent_of(swept[0])
    assert found is None
    assert "skd sweep --dense" in note


def test_a_file_that_is_none_is_refused(tmp_path, swept):
    path = tmp_path / "reference_recorded.npz"
    with pytest.raises(UsageError, match="reference_"):
        references_at(tmp_path)
    path.write_bytes(b"nothing")
    with pytest.raises(UsageError, match="reference_recorded"):
        load_reference(path)
    for wrong in ({"multipliers": np.array([0.9, 0.4, 1.4])}, {"about": np.frombuffer(b"{}", np.uint8)}):
        save_reference(path, reference_from(swept))
        with np.load(path) as content:
            arrays = dict(content)
        np.savez_compressed(path, **{**arrays, **wrong})
        with pytest.raises(UsageError, match="not a stored sweep"):
            load_reference(path)


def test_the_reference_that_comes_along_is_of_these_kamikazes():
    """Fails where kamikazes changed and `scripts/make-reference-sweep` was not run."""
    reference = shipped_reference()
    plan = Plan(CROSSING, kamikaze_count=100, objective=Objective.DEFORMATION)
    with InProcessRunner(1) as runner:
        safe = safe_trajectories(plan, runner)
        assert reference.mismatch(plan, safe) is None
        assert reference.multipliers.tolist() == list(DENSE)
        few = dataclasses.replace(plan, kamikaze_count=1, collision_runs=1)
        for row in (0, 25, -1):
            one = dataclasses.replace(few, multiplier=float(reference.multipliers[row]))
            found = attempt_deformations(assess(one, safe, runner, silent))
            for group, stored in zip(found, reference.deformations[row], strict=True):
                np.testing.assert_allclose(group, stored[: len(group)], rtol=0.0, atol=1e-9)
    assert not math.isnan(reference.deformations[:, :, :100].min())
