"""How much faster the risk and the margin of a policy are that answers many episodes at once: `commands`.

The same crossings and the same attempts are run one by one and side by side, in turns, in one worker: processor time of
the worker and of the policy's process, and the wall clock. Policies are those of `examples/batches`, and
`cars/thoughtful.py`, a wide network that takes milliseconds for a call, whether of one episode or of many. Results of
both are compared: of policies that compute each number apart, they are the same bits.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/batches.py [--crossings 1000] [--attempts 32] [--turns 3]
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import psutil
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.margin.search import attempts
from skd_evaluator.measure.behaviour.model import load_behaviour
from skd_evaluator.risk.any_car import AnyCar
from skd_evaluator.risk.assessment_risk import crude_crossings
from skd_evaluator.risk.batched_car import batched_car
from skd_evaluator.risk.crossings import Encounter
from skd_sim.choices.knowledge import Knowledge
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Mode
from skd_sim.geometry.trajectory import Trajectory

_EXAMPLES = str(Path(__file__).resolve().parents[1] / "examples" / "batches")
_HERE = str(Path(__file__).resolve().parent)
POLICIES = (
    "batch_policies:Anticipating",
    "batch_policies:SmallNetwork",
    "cars.thoughtful:Thoughtful",
)


def processor_time() -> float:
    """Return that of this process and of all below it, s."""
    total = 0.0
    for process in (psutil.Process(), *psutil.Process().children(recursive=True)):
        times = process.cpu_times()
        total += times.user + times.system
    return total


def timed(do: Callable[[], Any]) -> tuple[Any, float, float]:
    """Return what comes of it, and how long it took: processor time and wall clock, s."""
    used, begin = processor_time(), time.perf_counter()
    found = do()
    return found, processor_time() - used, time.perf_counter() - begin


def in_turns(single: Callable[[], Any], together: Callable[[], Any], turns: int) -> tuple[Any, Any, str]:
    """Run both forms in turns; return what each found, and in words how long it took."""
    single(), together()
    rows = [(timed(single), timed(together)) for _ in range(turns)]
    (one, *_), (many, *_) = rows[-1]
    times = [[statistics.median(row[form][kind] for row in rows) for kind in (1, 2)] for form in (0, 1)]
    ratios = [statistics.median(row[0][kind] / max(row[1][kind], 1e-2) for row in rows) for kind in (1, 2)]
    said = f"{times[0][0]:8.2f} s{times[1][0]:8.2f} s{ratios[0]:7.1f}{ratios[1]:14.1f}"
    return one, many, said


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", nargs="*", default=POLICIES)
    parser.add_argument("--crossings", type=int, default=1000, metavar="N", help="of the risk (default 1000)")
    parser.add_argument("--attempts", type=int, default=32, metavar="N", help="of the margin (default 32)")
    parser.add_argument("--turns", type=int, default=3, metavar="N", help="of each (default 3)")
    arguments = parser.parse_args()
    sys.path[:0] = [_EXAMPLES, _HERE]
    plan = Plan(load_scenario("crossing"), safe_count=4, knowledge=Knowledge.NOTHING, controller=POLICIES[0])
    safe = tuple(safe_trajectories(plan, InProcessRunner(1)))
    print(f"load {os.getloadavg()[0]:.1f}; processor time one by one and side by side; ratios: processor, wall clock")
    for policy in arguments.policy:
        _measure(replace(plan, controller=policy), safe, arguments)
    return 0


def _measure(plan: Plan, safe: tuple[Trajectory, ...], arguments: argparse.Namespace) -> None:
    """Measure one policy, and print what was found."""
    here = Encounter(plan, safe, load_behaviour("walkers").values)
    crossings = crude_crossings(here, arguments.crossings)
    phis = len(safe)
    episodes = [plan.episode(Mode.KAMIKAZE, k % phis, k // phis, safe[k % phis]) for k in range(arguments.attempts)]
    with InProcessRunner(1, isolated=True) as runner:
        runner.start()
        together = batched_car(here, runner)
        if together is None:
            print(f"{plan.controller}: answers one by one")
            return
        single = AnyCar(here, runner)
        one, many, said = in_turns(
            lambda: single.run(crossings, 1.0), lambda: together.run(crossings, 1.0), arguments.turns
        )
        same = np.array_equal(one.touch, many.touch) and np.array_equal(one.missed, many.missed)
        _say(plan.controller, f"risk, {len(crossings)} crossings", said, same)

        def margins() -> Any:
            return attempts.searched_margins(episodes, [()] * len(episodes), runner, lambda *_told: None, 256, 256)

        def one_by_one() -> Any:
            with mock.patch.object(attempts, "can_be_together", return_value=False):
                return margins()

        one, many, said = in_turns(one_by_one, margins, arguments.turns)
        same = all(np.array_equal(a.trace, b.trace) for a, b in zip(one.results, many.results, strict=True))
        _say("", f"margin, {len(episodes)} attempts", said, same)


def _say(policy: str, what: str, said: str, same: bool) -> None:
    print(f"{policy:30}{what:26}{said}  same bits: {'yes' if same else 'no'}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
