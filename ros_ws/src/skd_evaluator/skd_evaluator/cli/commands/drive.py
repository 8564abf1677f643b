"""`skd drive`: a scenario at the pace of the wall clock, with an adversary who is moved by keys or follows φ."""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from skd_sim.errors import AssessmentError, UsageError
from skd_sim.inputs.files import one_line

from skd_evaluator.assessment.options import GENERATED, SYNTHETIC, CampaignOptions, GraphOptions
from skd_evaluator.cli.arguments import Parser
from skd_evaluator.cli.output import finish, say

if TYPE_CHECKING:
    from skd_sim.world.episode import EpisodeLog, EpisodeSpec

    from skd_evaluator.assessment.plan import Plan
    from skd_evaluator.driving.drive import Controls, Drive, Screen

_NAP = 0.05  # s between two looks at the keys
_LENIENT = 3600.0  # s that the simulator may be late: nothing is rated here


def add(parser: Parser) -> None:
    """Watch a car drive, and step in front of it with the keyboard.

    Watch a car drive in real time, in the terminal. The adversary goes where your keys send it, or follows a safe
    trajectory φ. With --graph, RViz and Foxglove can show the drive, too. Nothing is rated. Without a terminal it
    prints one line a second and ends with the first episode.
    """
    parser.set_defaults(group="rate")
    followed = "follow safe trajectories φ instead of the keys; as skd assess takes them (default: it goes by keys)"
    parser.add_car(safe={"default": None, "help": followed})
    parser.add_count("--safe-number", 0, 65_534, "with --safe, by which φ to begin, counted from 0 (default: 0)")
    ticks = "end each episode after at most this many ticks, mostly of 0.3 s (default: as the scenario says)"
    parser.add_count("--ticks", 1, 100_000, ticks)
    parser.add_options("campaign")
    parser.add_graph()
    parser.add_parameters()
    group = parser.add_argument_group("output")
    group.add_flag("--json", "print how each episode ended as JSON, and no picture")
    group.add_loudness()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code: 1 where an episode was aborted."""
    from skd_evaluator.assessment.files.results import episode_summary
    from skd_evaluator.driving.drive import (
        KEYS,
        KEYS_OF_ONLOOKER,
        Controls,
        Lines,
        Screen,
        can_draw,
        drawing,
        reading_keys,
    )
    from skd_evaluator.report.presentation import episode_line
    from skd_evaluator.ros.session import prepare_ros

    plan, options = _plan_and_graph(arguments)
    watched = sys.stdin.isatty() and can_draw() and not (arguments.json or arguments.quiet)
    if not watched and arguments.safe is None and arguments.ticks is None:
        ways = "with --safe synthetic it follows a safe trajectory, with --ticks N it stands"
        raise UsageError(f"the adversary is moved by the keys of a terminal, and here is none: {ways}")
    if arguments.graph:
        prepare_ros(options)
    episodes = _Episodes(plan, arguments)
    controls, kept = Controls(), list[str]()
    try:
        with ExitStack() as stack:
            if watched:
                keys = KEYS if episodes.by_keys else KEYS_OF_ONLOOKER
                screen = Screen(one_line(options.controller_command or plan.car.label), keys)
                stack.enter_context(reading_keys(controls.press))
                stack.enter_context(drawing(screen))

                def hold(line: str) -> None:  # nothing is printed into a picture
                    screen.waiting = one_line(line)
                    kept.append(line)

                run_one = stack.enter_context(_driving(plan, options, episodes, controls, screen.show, hold))
                logs = list(_watched(run_one, episodes, controls, screen))
            else:
                output = sys.stderr if arguments.json else sys.stdout
                lines = Lines(lambda line: None if arguments.quiet else print(line, file=output, flush=True))
                tell = lambda line: say("drive", line)  # noqa: E731
                run_one = stack.enter_context(_driving(plan, options, episodes, controls, lines.show, tell))
                logs = [_driven(run_one, episodes.at(0))]
    finally:
        say("drive", *kept)
    content = {"episodes": [episode_summary(log) for log in logs]}
    return finish(arguments, content, lambda: print(*map(episode_line, logs), sep="\n", end="\n" if logs else ""))


class _Episodes:
    """The episodes of a drive by their numbers.

    Attributes:
        graph: whether they run through the node graph.
        by_keys: whether keys move the adversary.
    """

    def __init__(self, plan: Plan, arguments: argparse.Namespace) -> None:
        from skd_evaluator.assessment.run.workers import InProcessRunner
        from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories

        self.graph, self.by_keys, self._first = arguments.graph, arguments.safe is None, arguments.safe_number or 0
        if self.by_keys and arguments.safe_number is not None:
            raise UsageError(f"--safe-number {self._first}: there is no φ to follow; add --safe")
        # φ is found within the scenario's own horizon, whatever is shown of it.
        self._safe = [] if self.by_keys else safe_trajectories(plan, InProcessRunner(1))
        horizon = plan.scenario.horizon if arguments.ticks is None else arguments.ticks * plan.scenario.time_step
        self._plan = replace(plan, scenario=replace(plan.scenario, horizon=horizon))
        if not self.by_keys and self._first >= len(self._safe):
            there = f"there are {len(self._safe)} safe trajectories, numbered from 0"
            raise UsageError(f"--safe-number {self._first}: {there}")

    def at(self, number: int) -> EpisodeSpec:
        """Return the episode of a number: one φ after another, and new draws each time."""
        from skd_sim.world.episode import Mode

        if self.by_keys:
            return self._plan.episode(Mode.SAFE, 0, number, None)
        place = (self._first + number) % len(self._safe)
        return self._plan.episode(Mode.REPLAY, place, number // len(self._safe), self._safe[place])


def _plan_and_graph(arguments: argparse.Namespace) -> tuple[Plan, GraphOptions]:
    """Return car, scenario and φ, and how a graph is run.

    Raises:
        UsageError: some options do not go together.
    """
    from skd_adversary.safe_trajectories.sources import count_safe_trajectories
    from skd_sim.options.car_and_adversary import AdversaryModel
    from skd_sim.options.options import REAL_TIME, options_of, values_of

    from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for

    safe = arguments.safe or SYNTHETIC
    values: dict[str, Any] = {one.name: one.unsaid for one in options_of(GraphOptions)}
    scenario = scenario_for(arguments.scenario, safe)
    count = CampaignOptions.safe_count
    if safe not in GENERATED:
        count = max(1, min(count, count_safe_trajectories(safe, scenario)))
    unplanned = {"objective": "paper", "car_model": "", "adversary_model": str(AdversaryModel.GENERIC)}
    values |= {**vars(arguments), **unplanned, "safe": safe, "safe_count": count}
    plan = plan_of(values, scenario)
    both_ways = {} if arguments.graph else {"rate_factor": GraphOptions.rate_factor}
    scenario = check_car({**values, **both_ways}, plan.scenario, graph=arguments.graph)
    values |= {"pacing": REAL_TIME, "slip_limit": _LENIENT, "quiet_time": None}  # the wall clock does not wait
    return replace(plan, scenario=scenario), GraphOptions(**values_of(GraphOptions, values))


@contextmanager
def _driving(
    plan: Plan,
    options: GraphOptions,
    episodes: _Episodes,
    controls: Controls,
    show: Any,
    said: Callable[[str], None],
) -> Iterator[Drive]:
    """Yield what drives an episode, in this process or through the node graph."""
    from skd_evaluator.assessment.files.result_folder import ResultFolder
    from skd_evaluator.assessment.from_options import default_folder
    from skd_evaluator.driving.drive import Hand, driving_in_process
    from skd_evaluator.ros.processes import GraphSetting
    from skd_evaluator.ros.session import graph_session

    def hand_for(episode: EpisodeSpec) -> Hand | None:
        controls.hand = Hand(episode.scenario) if episodes.by_keys else None
        return controls.hand

    if not episodes.graph:
        yield driving_in_process(plan.car, options.rate_factor, hand_for, show, controls.look)
        return
    from skd_evaluator.ros.graph import Watched  # only here: ROS may be added by `prepare_ros`

    watched = Watched(hand_for, show, controls.look)
    with ResultFolder(default_folder("drive")).scratch() as scratch:
        setting = GraphSetting(options=options, car=plan.car, log_folder=scratch.logs, say=said)
        with graph_session(setting, watched) as evaluator:
            yield watched.driver(evaluator)


def _driven(drive: Drive, episode: EpisodeSpec) -> EpisodeLog:
    """Drive an episode to its end.

    Raises:
        AssessmentError: it was aborted.
    """
    from skd_sim.world.episode import Outcome

    log = drive(episode)
    if log.outcome == Outcome.ABORTED:
        raise AssessmentError(f"aborted: {log.reason}")
    return log


def _watched(drive: Drive, episodes: _Episodes, controls: Controls, screen: Screen) -> Iterator[EpisodeLog]:
    """Drive one episode after another until the user has seen enough; yield what happened in those that ended.

    Where keys move the adversary, the first one begins.
    """
    from skd_evaluator.driving.drive import LeftError, Wish
    from skd_evaluator.report.presentation import episode_line

    if episodes.by_keys:
        screen.waiting = "press a key to begin"
        while not controls.pressed:
            time.sleep(_NAP)
        if controls.take() is Wish.QUIT:
            return
        screen.waiting = "starting"
    for number in itertools.count():
        screen.over = ""
        try:
            log = _driven(drive, episodes.at(number))
            yield log
            screen.over = f"{episode_line(log)}. r: again, q: quit"
            while controls.look() is Wish.NONE:
                time.sleep(_NAP)
        except LeftError:
            pass
        if controls.take() is Wish.QUIT:
            return
