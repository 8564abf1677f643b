"""How often the intervals of `skd fuse --calibrate` hold the values that physical trials were played with.

Physical trials are played by the multi-body car with another delay, friction or brake than the simulator takes, and
noise of the brake (10 % of each command) and of the tracked places (2 cm). Each repetition has φ of people who walk as
in `fusion_trials.py`, a start of the car by lot, and one trial on each φ.

    PYTHONPATH=benchmarks nice .venv/bin/python benchmarks/simulator_fit.py [--repetitions 100] [--case NAME ...]
        [--trials N ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from fusion_trials import walks
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.extensions.fusion.calibration import (
    PARAMETERS,
    POOR,
    Recorded,
    SimulatorCalibration,
    calibrated,
    estimated,
    off_by,
)
from skd_evaluator.metrics.statistics import wilson_interval
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.simulators.simulator import Frame, WorldSimulator
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import FloatArray

NOISE = 0.02  # m
TRIALS = (12, 24)


@dataclass(frozen=True)
class Case:
    """A physical car, and what the simulator may be calibrated by."""

    name: str
    controller: str
    start_gap: float
    truth: dict[str, float]
    free: tuple[str, ...]
    control_period: float | None = None


CASES = (
    Case("basic, later brake", "basic", 14.0, {"delay": 0.25}, ("delay", "deceleration", "friction")),
    Case("basic, weak brake", "basic", 16.0, {"delay": 0.2, "deceleration": 2.8}, ("delay", "deceleration")),
    Case("time to collision, wet", "cars.collision_time:EarlyBrake", 22.0, {"delay": 0.3, "friction": 0.3},
         ("delay", "friction"), 0.05),
)  # fmt: skip


class Recording(WorldSimulator):
    """SKD's own world, which keeps the car's states of all control periods."""

    def reset(self, episode: EpisodeSpec) -> Frame:
        """Begin anew."""
        frame = super().reset(episode)
        self.states = [frame.car]
        return frame

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        """Advance, and keep."""
        frame = super().step(acceleration, velocity)
        self.states.append(frame.car)
        return frame


def physical(case: Case, world: Scenario, count: int, seed: int) -> list[Recorded]:
    """Return trials of the physical car."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(count,)))
    scenario = calibrated(world, case.truth)
    plan = Plan(scenario, seed=seed, controller=case.controller, safe_count=count)
    found = []
    for number, phi in enumerate(walks(count, rng, scenario.time_step)):
        shown = Recording()
        log = run_episode(plan.episode(Mode.REPLAY, number, 0, phi), simulator=shown)
        ticks = len(log.car) - 1 if np.isnan(log.impact_time) else int(log.impact_time / scenario.time_step)
        if ticks < 2:
            continue
        states = np.array(shown.states)[: ticks * scenario.control_periods + 1]
        states[:, :2] += NOISE * rng.standard_normal((len(states), 2))
        other = log.adversary[: ticks + 1] + NOISE * rng.standard_normal((ticks + 1, 2))
        found.append(Recorded(phi.name, other, states, phi.name))
    return found


def fitted(case: Case, world: Scenario, trials: list[Recorded]) -> SimulatorCalibration:
    """Return the calibration by trials."""
    start = {name: PARAMETERS[name].of(world) for name in PARAMETERS if not PARAMETERS[name].sensing}

    def off(values: Mapping[str, float]) -> list[FloatArray]:
        scenario = calibrated(world, values)
        return [off_by(scenario, CarUnderTest(case.controller, 1.0), one) for one in trials]

    return estimated(off, start, case.free, list(range(len(trials))))


def main() -> None:
    """Print a line for each case, number of trials and parameter."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=100, metavar="N")
    parser.add_argument("--case", nargs="+", choices=[one.name for one in CASES])
    parser.add_argument("--trials", nargs="+", type=int, default=TRIALS, metavar="N")
    arguments = parser.parse_args()
    print(
        "| physical car | trials | parameter | true | mean, deviation | half width | held | said |\n" + "|---" * 8 + "|"
    )
    for case in CASES:
        if arguments.case and case.name not in arguments.case:
            continue
        base = load_scenario("crossing_multi_body")
        car = replace(base.car, start_gap=case.start_gap, start_gap_range=2.5)
        world = replace(base, car=car, control_period=case.control_period)
        for count in arguments.trials:
            found = [fitted(case, world, physical(case, world, count, seed)) for seed in range(arguments.repetitions)]
            believed = [each for each in found if each.after <= POOR]
            for name in case.free:
                own = PARAMETERS[name].of(world)
                ones = [
                    one for each in believed for one in each.identified if one.parameter.name == name and one.interval
                ]
                true = case.truth.get(name, own)
                if not ones:
                    print(f"| {case.name} | {count} | {name} | {true:g} | | | | 0 |", flush=True)
                    continue
                held = sum(one.interval[0] <= true <= one.interval[1] for one in ones if one.interval)
                values = np.array([one.value for one in ones])
                half = float(np.mean([0.5 * (one.interval[1] - one.interval[0]) for one in ones if one.interval]))
                low, high = wilson_interval(held, len(ones))
                print(
                    f"| {case.name} | {count} | {name} | {true:g} | {values.mean():.3f}, {values.std():.3f} | "
                    f"{half:.3f} | {held} of {len(ones)} [{100 * low:.0f}, {100 * high:.0f}] % | "
                    f"{len(ones)} of {len(found)} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
