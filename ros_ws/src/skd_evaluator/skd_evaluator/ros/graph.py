"""A whole graph: its processes, its domain, and its evaluator.

No two graphs of one machine see each other: each has a ROS domain of its own. The last node of a context takes its
participant with it, and that may hang for ever in the middleware, in a loop that holds Python's global lock
(eProsima/Fast-DDS issue 6513). So a domain's context stays, with a node that keeps its participant, and a graph's own
nodes go when the next one of this process begins there. Python's own end takes down all that is left, within a bound
(`skd_sim.start`).

In a drive through the graph a user at the keys is the adversary, a node of this process, and sees it all (`Watched`).
"""

from __future__ import annotations

import atexit
import os
import random
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from skd_adversary.adversary import make_adversary
from skd_adversary.ros.adversary_node import AdversaryNode
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.ros.commands import car_commands
from skd_sim.ros.support import spin
from skd_sim.world.episode import AbortKind, EpisodeLog, EpisodeSpec, counts_in_words

from skd_evaluator.assessment.options import RESTART, managed_nodes
from skd_evaluator.driving.drive import Drive, HandFor, LeftError, Show, Wish
from skd_evaluator.ros import processes
from skd_evaluator.ros.evaluator import Evaluator
from skd_evaluator.ros.stack import resetting


@contextmanager
def running_graph(setting: processes.GraphSetting, watched: Watched | None = None) -> Iterator[Evaluator]:
    """Run a graph and yield its evaluator; all processes are gone afterwards, whatever happened.

    Args:
        setting: what it runs.
        watched: who takes part as the adversary, and watches; by default SKD's own node is the adversary.

    Raises:
        UsageError: a process cannot be started, or there are no such commands as the options say.
        AssessmentError: the graph cannot go on; says where the logs are.
    """
    options, domain = setting.options, choose_domain()
    car_commands(options)  # before anything is started: what is wrong with it is the user's to mend
    composed = watched is None and options.composes(setting.simulator)
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    programs = processes.graph_programs(options, setting.car, environment, composed=composed)
    if watched is not None:
        del programs[processes.ADVERSARY]
    anew = RESTART in options.resets

    def check_processes() -> str | None:
        if watched is not None:
            watched.check()
        return supervisor.check()

    def before_episode() -> str | None:
        if anew:
            supervisor.restart([processes.CONTROLLER])
        return reset()

    with ExitStack() as stack:
        supervisor = stack.enter_context(processes.Supervisor(programs, setting.log_folder, setting.say))
        context, nodes = stack.enter_context(_place_in(domain))
        evaluator = Evaluator(context, options if composed else None, start_parameter_services=False)
        nodes.append(evaluator)
        if watched is not None:
            nodes.append(stack.enter_context(watched.adversary(context)))
            evaluator.watch(watched.show, options)
        managed = managed_nodes(options.lifecycle_nodes)
        reset = stack.enter_context(resetting(context, managed, options.startup_timeout, check_processes))
        evaluator.begin_campaign(
            setting.campaign or processes.campaign_name(setting.car),
            record_to=setting.record_to,
            silence_limit=options.startup_timeout + 30.0,
            check_processes=check_processes,
            before_episode=before_episode,
            after_silence=lambda reason: supervisor.restart(processes.concerned(reason)),
            commands=options,
            own_world=True,
            anew=anew,
            answers_each_state=options.answers_each_state,
            say=setting.say,
            log_folder=setting.log_folder,
        )
        topic = evaluator.resolve_topic_name(options.command_topic)
        if setting.awaits_car and not evaluator.count_publishers(topic):
            setting.say(f"waiting for a publisher of {topic} (ROS_DOMAIN_ID={domain})")
        try:
            yield evaluator
        except AssessmentError as error:
            reasons = evaluator.failures.reasons
            counts = f"; aborted episodes: {counts_in_words(reasons)}" if reasons else ""
            log = processes.log_of(setting.log_folder, str(error))
            error.args = (f"{error}{counts}; log: {log}",)  # its kind stays
            raise


_idle: dict[int, tuple[Context, list[Node]]] = {}
"""Domains in which a graph has ended: the context, the node that keeps its participant, and the graph's own nodes."""
_HIGHEST_DOMAIN = 101  # above it, DDS ports run into Linux's ephemeral range
_PORT_BASE, _PORTS_PER_DOMAIN = 7400, 250  # DDSI-RTPS 2.2, section 9.6.1
_reserved: list[socket.socket] = []
"""Held until this process ends, so that no other chooses the same domain before its nodes are up."""


def choose_domain() -> int:
    """Return $ROS_DOMAIN_ID where it is set, else a domain that is not in use on this machine.

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
    """Return a domain in which a graph of this process has ended, else one that is not in use on this machine.

    Raises:
        UsageError: there is none.
    """
    if _idle:
        return min(_idle)
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


@contextmanager
def _place_in(domain: int) -> Iterator[tuple[Context, list[Node]]]:
    """Yield the context of a domain, and a list for nodes that are to live until the next graph begins there."""
    if domain not in _idle:
        context = Context()
        rclpy.init(args=[], context=context, domain_id=domain)
        keeper = Node("_skd_context", context=context, start_parameter_services=False, enable_rosout=False)
        _idle[domain] = context, [keeper]
    context, nodes = _idle.pop(domain)
    while len(nodes) > 1:
        nodes.pop().destroy_node()
    try:
        yield context, nodes
    finally:
        _idle[domain] = context, nodes


@atexit.register
def end_contexts() -> None:
    """Take down all contexts that no graph uses."""
    while _idle:
        context, nodes = _idle.popitem()[1]
        for node in reversed(nodes):
            node.destroy_node()
        rclpy.try_shutdown(context=context)


_FAREWELL = 2.0  # s for the node's thread to end


class Watched:
    """What a graph needs so that a user can watch and take part.

    Attributes:
        show: called with each situation.
    """

    def __init__(self, hand_for: HandFor, show: Show, look: Callable[[], Wish]) -> None:
        """Prepare.

        Args:
            hand_for: gives who moves the adversary.
            show: called with each situation.
            look: says what the user wishes.
        """
        self._hand_for, self.show, self._look = hand_for, show, look
        self._evaluator: Evaluator | None = None

    @contextmanager
    def adversary(self, context: Context) -> Iterator[Node]:
        """Run the adversary's node in a context, in a thread, as long as this lasts, and yield it."""
        node = AdversaryNode(make=lambda one: self._hand_for(one) or make_adversary(one), context=context)
        over = threading.Event()

        def run() -> None:
            with suppress(ExternalShutdownException):
                spin(node, over.is_set)

        thread = threading.Thread(target=run, name="skd-drive", daemon=True)
        thread.start()
        try:
            yield node
        finally:
            over.set()
            thread.join(_FAREWELL)

    def check(self) -> None:
        """Do what the user wishes; to be called while the evaluator waits.

        Raises:
            LeftError: the user has seen enough.
        """
        wish = self._look()
        if wish is Wish.QUIT:
            raise LeftError
        if wish is Wish.AGAIN and self._evaluator is not None:
            self._evaluator.refuse(AbortKind.OTHER, "the user began anew")

    def driver(self, evaluator: Evaluator) -> Drive:
        """Return what runs an episode of an evaluator's graph."""
        self._evaluator = evaluator

        def drive(episode: EpisodeSpec) -> EpisodeLog:
            log = evaluator.run_episode(episode)
            if self._look() is not Wish.NONE:
                raise LeftError
            return log

        return drive
