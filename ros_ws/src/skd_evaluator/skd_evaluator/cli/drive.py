"""`skd drive`: a scenario at the pace of the wall clock, with an adversary who is moved by keys or follows φ."""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

from skd_adversary.safe_trajectories.sources import count_safe_trajectories
from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line
from skd_sim.options.adversary import AdversaryModel
from skd_sim.options.options import REAL_TIME, options_of, values_of
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome

from skd_evaluator.assessment.files.result_folder import ResultFolder
from skd_evaluator.assessment.files.results import episode_summary
from skd_evaluator.assessment.from_options import check_car, default_folder, plan_of, scenario_for
from skd_evaluator.assessment.options import GENERATED, SYNTHETIC, CampaignOptions, GraphOptions
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.cli.output import print_json
from skd_evaluator.driving.drive import Controls, Drive, Hand, LeftError, Wish, driving_in_process
from skd_evaluator.driving.screen import KEYS, KEYS_OF_ONLOOKER, Lines, Screen, can_draw, drawing, terminal
from skd_evaluator.errors import AssessmentError
from skd_evaluator.report.presentation import episode_line
from skd_evaluator.ros.processes import GraphSetting
from skd_evaluator.ros.session import graph_session, prepare_ros

_NAP = 0.05  # s between two looks at the keys
_LENIENT = 3600.0  # s that the simulator may be late: nothing is rated here
_NOBODY_PLANS = {"objective": "paper", "car_model": "", "adversary_model": str(AdversaryModel.GENERIC)}


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code: 1 where an episode was aborted."""
    watched = sys.stdin.isatty() and can_draw() and not (arguments.json or arguments.quiet)
    if not watched and arguments.safe is None and arguments.ticks is None:
        raise UsageError(
            "the adversary is moved by the keys of a terminal, and here is none: with --safe synthetic it follows a "
            "safe trajectory, with --ticks N it stands"
        )
    plan, options = _plan_and_graph(arguments)
    if arguments.graph:
        prepare_ros(options)
    episodes = _Episodes(plan, arguments)
    controls, said = Controls(), _Messages()
    try:
        with ExitStack() as stack:
            if watched:
                title = one_line(options.controller_command or plan.car.label)
                screen = stack.enter_context(_on_terminal(title, controls, by_keys=episodes.by_keys))
                said.keep(screen)
                drive = stack.enter_context(_driving(plan, options, episodes, controls, screen.show, said, arguments))
                logs = list(_watched(drive, episodes, controls, screen))
            else:
                show = Lines(_writer(arguments)).show
                drive = stack.enter_context(_driving(plan, options, episodes, controls, show, said, arguments))
                logs = [_driven(drive, episodes.at(0))]
    finally:
        said.say_kept()
    if arguments.json:
        print_json({"episodes": [episode_summary(log) for log in logs]})
    else:
        for log in logs:
            print(episode_line(log))
    return 0


class _Episodes:
    """The episodes of a drive by their numbers."""

    def __init__(self, plan: Plan, arguments: argparse.Namespace) -> None:
        self.by_keys = arguments.safe is None
        if self.by_keys and arguments.safe_number is not None:
            raise UsageError(f"--safe-number {arguments.safe_number}: there is no φ to follow; add --safe")
        self._plan, self._first = plan, arguments.safe_number or 0
        # φ is found within the scenario's own horizon, whatever is shown of it.
        self._safe = [] if self.by_keys else safe_trajectories(plan, InProcessRunner(1))
        if arguments.ticks is not None:
            horizon = arguments.ticks * plan.scenario.time_step
            self._plan = replace(plan, scenario=replace(plan.scenario, horizon=horizon))
        if not self.by_keys and self._first >= len(self._safe):
            raise UsageError(
                f"--safe-number {self._first}: there are {len(self._safe)} safe trajectories, numbered from 0"
            )

    def at(self, number: int) -> EpisodeSpec:
        """Return the episode of a number: one φ after another, and new draws each time."""
        if self.by_keys:
            return self._plan.episode(Mode.SAFE, 0, number, None)
        place = (self._first + number) % len(self._safe)
        return self._plan.episode(Mode.REPLAY, place, number // len(self._safe), self._safe[place])


class _Messages:
    """Lines for the user, of which none is printed into a picture."""

    def __init__(self) -> None:
        self._screen: Screen | None = None
        self._kept: list[str] = []

    def keep(self, screen: Screen) -> None:
        """Keep lines from now on; the screen has the last one."""
        self._screen = screen

    def __call__(self, line: str) -> None:
        """Say a line."""
        if self._screen is None:
            print(f"skd drive: {line}", file=sys.stderr, flush=True)
        else:
            self._screen.waiting = one_line(line)
            self._kept.append(line)

    def say_kept(self) -> None:
        """Say all that was kept."""
        for line in self._kept:
            print(f"skd drive: {line}", file=sys.stderr)


def _plan_and_graph(arguments: argparse.Namespace) -> tuple[Plan, GraphOptions]:
    """Return car, scenario and φ, and how a graph is run.

    Raises:
        UsageError: some options do not go together.
    """
    safe = arguments.safe or SYNTHETIC
    values: dict[str, Any] = {one.name: one.unsaid for one in options_of(GraphOptions)}
    scenario = scenario_for(arguments.scenario, safe)
    count = CampaignOptions.safe_count
    if safe not in GENERATED:
        count = max(1, min(count, count_safe_trajectories(safe, scenario)))
    values |= {**vars(arguments), **_NOBODY_PLANS, "safe": safe, "safe_count": count}
    plan = plan_of(values, scenario)
    both_ways = {} if arguments.graph else {"rate_factor": GraphOptions.rate_factor}
    scenario = check_car({**values, **both_ways}, plan.scenario, graph=arguments.graph)
    values |= {"pacing": REAL_TIME, "slip_limit": _LENIENT, "quiet_time": None}  # the wall clock does not wait
    return replace(plan, scenario=scenario), GraphOptions(**values_of(GraphOptions, values))


@contextmanager
def _on_terminal(title: str, controls: Controls, *, by_keys: bool) -> Iterator[Screen]:
    """Draw on the terminal and read its keys, as long as this lasts."""
    from skd_evaluator.driving.drive import reading_keys

    console = terminal()
    screen = Screen(title, KEYS if by_keys else KEYS_OF_ONLOOKER, console)
    with reading_keys(controls.press), drawing(screen, console):
        yield screen


def _writer(arguments: argparse.Namespace) -> Callable[[str], None]:
    output = sys.stderr if arguments.json else sys.stdout
    return (lambda _line: None) if arguments.quiet else lambda line: print(line, file=output, flush=True)


@contextmanager
def _driving(
    plan: Plan,
    options: GraphOptions,
    episodes: _Episodes,
    controls: Controls,
    show: Any,
    said: _Messages,
    arguments: argparse.Namespace,
) -> Iterator[Drive]:
    """Yield what drives an episode, in this process or through the node graph."""

    def hand_for(episode: EpisodeSpec) -> Hand | None:
        controls.hand = Hand(episode.scenario) if episodes.by_keys else None
        return controls.hand

    if not arguments.graph:
        with driving_in_process(plan.car, options.rate_factor, hand_for, show, controls.look) as drive:
            yield drive
        return
    from skd_evaluator.ros.driving import Watched  # only here: ROS may be added by `prepare_ros`

    watched = Watched(options, hand_for, show, controls.look)
    with ResultFolder(default_folder("drive")).scratch() as scratch:
        setting = GraphSetting(options=options, car=plan.car, log_folder=scratch.logs, say=said)
        with graph_session(setting, watched) as evaluator:
            yield watched.driver(evaluator)


def _driven(drive: Drive, episode: EpisodeSpec) -> EpisodeLog:
    """Drive an episode to its end.

    Raises:
        AssessmentError: it was aborted.
    """
    log = drive(episode)
    if log.outcome == Outcome.ABORTED:
        raise AssessmentError(f"aborted: {log.reason}")
    return log


def _watched(drive: Drive, episodes: _Episodes, controls: Controls, screen: Screen) -> Iterator[EpisodeLog]:
    """Drive one episode after another until the user has seen enough; yield what happened in those that ended.

    Where keys move the adversary, the first one begins.
    """
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
