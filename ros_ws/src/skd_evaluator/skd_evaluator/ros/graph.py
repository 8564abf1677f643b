"""Whole graphs: processes, domain and evaluator of one, and a pool of several that run the episodes of one campaign.

**Pool.** Each graph runs in a thread and takes the next episode when its stack is ready for it: while one starts its
controller anew, another drives. Which graph runs an episode does not matter to what becomes of it. A thread starts all
processes of its graph, and lives longer than they.

**Domains.** No two graphs of one machine see each other. The last node of a context takes its participant with it, and
that may hang for ever in the middleware, in a loop that holds Python's global lock (eProsima/Fast-DDS issue 6513), with
an assessment that is not written yet. So a graph that has ended leaves its context and its nodes as they are. The next
graph of this process in that domain takes both over: then its predecessor's nodes go, but not the participant, which a
node without anything keeps. Python's own end takes down all that is left, within a bound (`skd_sim.start`).
"""

from __future__ import annotations

import atexit
import contextlib
import os
import random
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from types import TracebackType

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from skd_sim.errors import UsageError
from skd_sim.ros.commands import car_commands
from skd_sim.world.episode import Episode, EpisodeLog

from skd_evaluator.assessment.assessment import Rating
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
        context, done = stack.enter_context(context_of(domain))
        evaluator = Evaluator(context, name, options if composed else None, start_parameter_services=False)
        done.append(evaluator)  # it goes later: its end may hang, and nothing is written yet
        if watched is not None:
            done.append(stack.enter_context(watched.adversary(context)))
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


_POLL = 0.25  # s
_FAREWELL = 30.0  # s that a graph's thread has to end its processes, which have three times three
_ECHO = 8.0  # s: graphs that wait for the same began within a few, and repeat themselves after ten


class _Stopped(BaseException):
    """The pool is to end; no episode is worth waiting for any more."""


MakeGraph = Callable[[int, Callable[[], None]], AbstractContextManager[Evaluator]]
"""Runs the graph of a number, counted from 0, which calls the function while it waits, to be stopped by it."""


def without_echo(say: Callable[[str], None]) -> Callable[[str], None]:
    """Return what says a line once where several graphs say the same at the same time."""
    lock = threading.Lock()
    said: dict[str, float] = {}

    def say_once(line: str) -> None:
        with lock:
            now = time.monotonic()
            if now - said.get(line, -_ECHO) >= _ECHO:
                said[line] = now
                say(line)

    return say_once


class GraphPool:
    """Runs episodes in as many graphs as it has; an `EpisodeRunner`."""

    def __init__(self, count: int, make: MakeGraph, failures: AbortedEpisodes, patience: float) -> None:
        """Start nothing yet.

        Args:
            count: how many graphs there are.
            make: makes each, in its own thread.
            failures: takes note of every episode.
            patience: how long a stack that was started anew may take to be there, wall seconds.
        """
        self._make = make
        self._failures = failures
        self._patience = patience
        self._changed = threading.Condition()
        self._stopping = False
        self._waiting: deque[tuple[int, Episode]] = deque()
        self._logs: dict[int, EpisodeLog] = {}
        self._asked = 0  # episodes, in all batches; one that nobody waits for any more takes no other's place
        self._error: BaseException | None = None
        self._evaluators: dict[int, Evaluator] = {}
        self._threads = [threading.Thread(target=self._serve, args=(number,), daemon=True) for number in range(count)]

    def __enter__(self) -> GraphPool:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._stopping = True
            self._waiting.clear()
            self._changed.notify_all()
        interrupted: KeyboardInterrupt | None = None
        # A signal in the middle of an import may leave Python's import lock taken for good, and with it a thread that
        # has something to import. Whatever such a thread has started is ended with this process.
        latest = time.monotonic() + _FAREWELL
        for thread in self._threads:
            while thread.is_alive() and time.monotonic() < latest:
                try:
                    thread.join(_POLL)
                except KeyboardInterrupt as again:  # the processes are being ended already, each with its deadline
                    interrupted = again
        if interrupted is not None and kind is None:
            raise interrupted

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run episodes and yield their logs in the order of the episodes.

        Raises:
            AssessmentError: a graph cannot go on, or one episode after the other fails at its start.
        """
        with self._changed:
            first, self._asked = self._asked, self._asked + len(episodes)
            self._waiting.extend(enumerate(episodes, first))
            self._changed.notify_all()
        try:
            for number in range(first, first + len(episodes)):
                log = self._log_of(number)
                self._failures.note(log)
                yield log
        finally:
            with self._changed:
                self._waiting.clear()

    def publish_assessment(self, rating: Rating) -> None:
        """Publish an assessment in the first graph's domain, as soon as it is there: others may have done all the work.

        Raises:
            AssessmentError: that graph cannot start.
        """
        with self._changed:
            while 0 not in self._evaluators:
                if self._error is not None:
                    raise self._error
                self._changed.wait(_POLL)
        self._evaluators[0].publish_assessment(rating)

    def _log_of(self, number: int) -> EpisodeLog:
        with self._changed:
            while number not in self._logs:
                if self._error is not None:
                    raise self._error
                self._changed.wait(_POLL)
            return self._logs.pop(number)

    # --- in a graph's thread

    def _serve(self, number: int) -> None:
        try:
            with self._make(number, self._refuse_to_go_on) as evaluator:
                with self._changed:
                    self._evaluators[number] = evaluator
                    self._changed.notify_all()
                while True:
                    evaluator.prepare(self._patience)
                    place, episode = self._next()
                    log = evaluator.run_episode(episode)
                    with self._changed:
                        self._logs[place] = log
                        self._changed.notify_all()
        except _Stopped:
            pass
        except BaseException as error:
            with self._changed:
                self._error = self._error or error
                self._changed.notify_all()

    def _next(self) -> tuple[int, Episode]:
        with self._changed:
            while not self._waiting:
                self._refuse_to_go_on()
                self._changed.wait(_POLL)
            return self._waiting.popleft()

    def _refuse_to_go_on(self) -> None:
        if self._stopping:
            raise _Stopped


_HIGHEST_DOMAIN = 101  # above it, DDS ports run into Linux's ephemeral range
_PORT_BASE, _PORTS_PER_DOMAIN, _FIRST_UNICAST = 7400, 250, 10  # DDSI-RTPS 2.2, section 9.6.1
_PARTICIPANTS = 8  # of a domain that are looked for
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


def free_domain(others: Collection[int] = ()) -> int:
    """Return a domain that nobody on this machine uses, or in which a graph of this process has ended.

    Args:
        others: domains that are taken, although nobody may be there yet.

    Raises:
        UsageError: there is none.
    """
    candidates = random.SystemRandom().sample(range(1, _HIGHEST_DOMAIN + 1), _HIGHEST_DOMAIN)
    for domain in [*_idle, *candidates]:
        if domain not in others and (domain in _idle or (not _in_use(domain) and _reserve(domain))):
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


def _in_use(domain: int) -> bool:
    """Whether a participant of this machine holds one of the domain's first unicast discovery ports.

    That of the first participant alone says nothing: it may have ended before the others.
    """
    first = _PORT_BASE + _PORTS_PER_DOMAIN * domain + _FIRST_UNICAST
    for participant in range(_PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("0.0.0.0", first + 2 * participant))
            except OSError:
                return True
    return False


@dataclass
class _DomainContext:
    """A context, the node that keeps its participant, and nodes that have done their work."""

    context: Context
    keeper: Node
    done: list[Node] = field(default_factory=list)

    def clear(self) -> None:
        while self.done:
            self.done.pop().destroy_node()

    def end(self) -> None:
        self.clear()
        self.keeper.destroy_node()
        rclpy.try_shutdown(context=self.context)


_idle: dict[int, _DomainContext] = {}
_lock = threading.Lock()  # of these


@contextlib.contextmanager
def context_of(domain: int) -> Iterator[tuple[Context, list[Node]]]:
    """Yield a context of a domain, and a list for nodes that are to live as long as it does."""
    with _lock:
        place = _idle.pop(domain, None)
    if place is None:
        context = Context()
        rclpy.init(args=[], context=context, domain_id=domain)
        keeper = Node("_skd_context", context=context, start_parameter_services=False, enable_rosout=False)
        place = _DomainContext(context, keeper)
    place.clear()
    try:
        yield place.context, place.done
    finally:
        with _lock:
            second = _idle.get(domain)  # another graph's in the same domain
            _idle[domain] = place
        if second is not None:
            second.end()


@atexit.register
def end_contexts() -> None:
    """Take down all contexts that nobody uses."""
    with _lock:
        places = list(_idle.values())
        _idle.clear()
    for place in places:
        place.end()
