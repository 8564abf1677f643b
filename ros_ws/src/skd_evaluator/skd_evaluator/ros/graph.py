"""Whole graphs: processes, domain and evaluator of one, and several that share the episodes of one campaign.

No two graphs of one machine see each other: each has a ROS domain of its own. The last node of a context takes its
participant with it, and that may hang for ever in the middleware, in a loop that holds Python's global lock
(eProsima/Fast-DDS issue 6513). So a domain's context stays, with a node that keeps its participant, and a graph's own
nodes go when the next one of this process begins there. Python's own end takes down all that is left, within a bound
(`skd_sim.start`).
"""

from __future__ import annotations

import atexit
import os
import random
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from queue import SimpleQueue

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from skd_sim.errors import UsageError
from skd_sim.ros.commands import car_commands
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.options import RESTART, managed_nodes
from skd_evaluator.ros.driving import Watched
from skd_evaluator.ros.evaluator import Evaluator
from skd_evaluator.ros.processes import (
    ADVERSARY,
    CONTROLLER,
    AbortedEpisodes,
    GraphSetting,
    Supervisor,
    concerned,
    graph_programs,
)
from skd_evaluator.ros.stack import resetting


@contextmanager
def running_graph(
    setting: GraphSetting,
    domain: int,
    name: str = "evaluator",
    refuse_to_go_on: Callable[[], None] = lambda: None,
    watched: Watched | None = None,
) -> Iterator[Evaluator]:
    """Run a graph and yield its evaluator; all processes are gone afterwards, whatever happened.

    Args:
        setting: what it runs.
        domain: ROS domain id.
        name: name of the evaluator's node.
        refuse_to_go_on: called while the evaluator waits; an exception that it raises ends the graph.
        watched: who takes part as the adversary, and watches; by default SKD's own node is the adversary.

    Raises:
        UsageError: a process cannot be started, or there are no such commands as the options say.
        AssessmentError: the graph cannot go on.
    """
    options = setting.options
    car_commands(options)  # before anything is started: what is wrong with it is the user's to mend
    composed = watched is None and options.composes(setting.simulator)
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    programs = graph_programs(options, setting.car, environment, composed=composed)
    if watched is not None:
        del programs[ADVERSARY]

    def check_processes() -> str | None:
        refuse_to_go_on()
        if watched is not None:
            watched.check()
        return supervisor.check()

    def replace_silent(reason: str) -> None:
        for name in concerned(reason):
            supervisor.restart(name)

    def before_episode() -> str | None:
        if RESTART in options.resets:
            supervisor.restart(CONTROLLER)
        return reset()

    with ExitStack() as stack:
        supervisor = stack.enter_context(Supervisor(programs, setting.log_folder, setting.say))
        context, nodes = stack.enter_context(_place_in(domain))
        evaluator = Evaluator(context, name, options if composed else None, start_parameter_services=False)
        nodes.append(evaluator)
        if watched is not None:
            nodes.append(stack.enter_context(watched.adversary(context)))
        reset = stack.enter_context(
            resetting(
                context,
                managed_nodes(options.lifecycle_nodes),
                patience=options.startup_timeout,
                check_processes=check_processes,
            )
        )
        evaluator.begin_campaign(
            setting.campaign,
            record_to=setting.record_to,
            silence_limit=options.startup_timeout + 30.0,
            check_processes=check_processes,
            before_episode=before_episode,
            after_silence=replace_silent,
            commands=options,
            own_world=True,
            anew=RESTART in options.resets,
            answers_each_state=options.answers_each_state,
            say=setting.say,
            log_folder=setting.log_folder,
        )
        yield evaluator


class _StoppedError(Exception):
    """The campaign has ended, and with it the episodes that are still running."""


class GraphPool:
    """Runs the episodes of one campaign in several graphs; an `Runner`."""

    def __init__(self, evaluators: Sequence[Evaluator], failures: AbortedEpisodes) -> None:
        """Take the graphs' evaluators, all of them idle, and what takes note of every episode."""
        self._evaluators, self._failures = evaluators, failures
        self._idle: SimpleQueue[Evaluator] = SimpleQueue()
        for evaluator in evaluators:
            self._idle.put(evaluator)
        self._executor = ThreadPoolExecutor(len(evaluators), "skd-graph")

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        """Run episodes and yield their logs in the order of the episodes.

        Raises:
            AssessmentError: a graph cannot go on, or one episode after the other fails at its start.
        """
        futures = [self._executor.submit(self._run_episode, episode) for episode in episodes]
        try:
            for future in futures:
                log = future.result()
                self._failures.note(log)
                yield log
        finally:
            for future in futures:
                future.cancel()

    def _run_episode(self, episode: EpisodeSpec) -> EpisodeLog:
        evaluator = self._idle.get()
        try:
            return evaluator.run_episode(episode)
        finally:
            self._idle.put(evaluator)

    def publish_assessment(self, assessment: Assessment) -> None:
        """Publish an assessment in the first graph's domain."""
        self._evaluators[0].publish_assessment(assessment)

    def close(self) -> None:
        """Wait for the episodes that are running, and begin no other."""
        self._executor.shutdown(cancel_futures=True)


@contextmanager
def running_graphs(setting: GraphSetting, failures: AbortedEpisodes) -> Iterator[GraphPool]:
    """Run as many graphs as the options say and yield what runs episodes in them; see `running_graph`."""
    stopping = threading.Event()

    def refuse_to_go_on() -> None:
        if stopping.is_set():
            raise _StoppedError

    with ExitStack() as stack:
        evaluators = []
        for number in range(setting.options.graphs):
            which = f"{number + 1}" if number else ""  # the first is as if it were the only one
            folder = setting.log_folder / f"graph{which}" if which else setting.log_folder
            folder.mkdir(exist_ok=True)
            one, domain = replace(setting, log_folder=folder), free_domain() if number else choose_domain()
            evaluators.append(stack.enter_context(running_graph(one, domain, f"evaluator{which}", refuse_to_go_on)))
        pool = GraphPool(evaluators, failures)
        try:
            yield pool
        finally:
            stopping.set()
            pool.close()


_HIGHEST_DOMAIN = 101  # above it, DDS ports run into Linux's ephemeral range
_PORT_BASE, _PORTS_PER_DOMAIN = 7400, 250  # DDSI-RTPS 2.2, section 9.6.1
_reserved: list[socket.socket] = []
"""Held until this process ends, so that no other chooses the same domain before its nodes are up."""


def choose_domain() -> int:
    """Return $ROS_DOMAIN_ID where it is set, else a domain that nobody on this machine uses.

    Raises:
        UsageError: the variable is not a domain.
    """
    given = os.environ.get("ROS_DOMAIN_ID", "")
    if not given:
        return free_domain()
    if not (given.isdecimal() and int(given) <= 232):
        raise UsageError(f"ROS_DOMAIN_ID must be a whole number from 0 to 232, got {given!r}")
    return int(given)


def free_domain() -> int:
    """Return a domain in which a graph of this process has ended, else one that nobody on this machine uses.

    Raises:
        UsageError: there is none.
    """
    if _idle:
        return _idle[0][0]
    for domain in random.SystemRandom().sample(range(1, _HIGHEST_DOMAIN + 1), _HIGHEST_DOMAIN):
        if _reserve(domain) and not is_in_use(domain):
            return domain
    raise UsageError("every ROS domain from 1 to 101 is in use on this machine; set ROS_DOMAIN_ID")


def _reserve(domain: int) -> bool:
    """Whether the domain is now ours among all processes that choose one by this function (Linux only, else always)."""
    if not sys.platform.startswith("linux"):
        return True
    holder = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        holder.bind(f"\0skd-ros-domain-{domain}")
    except OSError:
        holder.close()
        return False
    _reserved.append(holder)
    return True


def is_in_use(domain: int) -> bool:
    """Return whether a participant of this machine holds a port of the domain.

    All are tried: a process numbers its participants, and so their ports, across all domains.
    """
    first = _PORT_BASE + _PORTS_PER_DOMAIN * domain
    for port in range(first, first + _PORTS_PER_DOMAIN):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("0.0.0.0", port))
            except OSError:
                return True
    return False


_idle: list[tuple[int, Context, list[Node]]] = []
"""Domains in which a graph has ended: the context, the node that keeps its participant, and the graph's own nodes."""


@contextmanager
def _place_in(domain: int) -> Iterator[tuple[Context, list[Node]]]:
    """Yield the context of a domain, and a list for nodes that are to live until the next graph begins there."""
    place = next((one for one in _idle if one[0] == domain), None)
    if place is None:
        context = Context()
        rclpy.init(args=[], context=context, domain_id=domain)
        keeper = Node("_skd_context", context=context, start_parameter_services=False, enable_rosout=False)
        place = domain, context, [keeper]
    else:
        _idle.remove(place)
    _, context, nodes = place
    while len(nodes) > 1:
        nodes.pop().destroy_node()
    try:
        yield context, nodes
    finally:
        _idle.append(place)


@atexit.register
def end_contexts() -> None:
    """Take down all contexts that no graph uses."""
    while _idle:
        _, context, nodes = _idle.pop()
        for node in reversed(nodes):
            node.destroy_node()
        rclpy.try_shutdown(context=context)
