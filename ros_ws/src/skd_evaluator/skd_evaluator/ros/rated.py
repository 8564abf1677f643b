"""An assessment through graphs that SKD runs, and whether the car in them is the one that its episodes show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.graph_options import LOCKSTEP
from skd_sim.choices.objective import Objective
from skd_sim.choices.simulators import is_own_world
from skd_sim.episode.episode import EpisodeLog

from skd_evaluator.assessing.again import DoubtsOfLearning, Fresh
from skd_evaluator.assessing.again_graph import TimedRunner, doubts_of_the_stack, groups_of
from skd_evaluator.assessing.graph_options import GraphOptions
from skd_evaluator.assessing.pipeline import Further, Runners, assessed, keep_or_forget, learned_plan
from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.plan.plan import EpisodeRunner, Plan, Progress
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.ros.session import campaign_name, graphs_session


def fresh_process(car: CarUnderTest, simulator: str, options: GraphOptions) -> Fresh | None:
    """Return what makes a process in which episodes of a graph are run again, to the last bit; None where none are.

    Args:
        car: what is rated: only a Python class runs in a process, too.
        simulator: name of the simulator.
        options: how the graph is run.
    """
    if car.is_own or car.is_external or not repeats(simulator, options):
        return None
    return partial(InProcessRunner, 1, isolated=True, answer_limit=options.startup_timeout)


def repeats(simulator: str, options: GraphOptions) -> bool:
    """Whether an episode that is run again goes as before, if the car answers by what it hears."""
    return options.pacing == LOCKSTEP and is_own_world(simulator)


class RunAgain:
    """Looks whether a stack is the car that its episodes show, by running some again through a graph.

    A stack is a node of its own, and a class in Python in real time, whose episodes no process repeats.

    Attributes:
        here: whether they are run in the graph that there is, which goes on with the same stack.
        anew: whether they are run in one with a stack that is started for it, after that graph has ended.
    """

    def __init__(self, car: CarUnderTest, simulator: str, options: GraphOptions, log_folder: Path) -> None:
        """Look at nothing yet.

        Args:
            car: what is rated.
            simulator: name of the simulator.
            options: how the graph that there is is run.
            log_folder: folder with the output of its processes; that of further graphs goes below it.
        """
        self._car, self._simulator, self._options, self._log_folder = car, simulator, options, log_folder
        is_stack = not car.is_own and is_own_world(simulator) and fresh_process(car, simulator, options) is None
        self.anew = is_stack and (not car.is_external or bool(options.controller_command))
        self.here = is_stack and not self.anew

    def doubts(
        self,
        groups: Sequence[Sequence[EpisodeLog]],
        limit: float,
        progress: Progress,
        evaluator: EpisodeRunner | None = None,
    ) -> tuple[str, ...]:
        """Return, a line each, why it is not that car; see `doubts_of_the_stack`.

        Args:
            groups: episodes; some of each group are run again.
            limit: how long a graph may take to run them again, wall seconds.
            progress: called with how far the work is.
            evaluator: runs the graph that there is; None: run graphs anew.
        """
        return doubts_of_the_stack(
            self._car.controller,
            groups,
            self._graph_anew if evaluator is None else lambda: nullcontext(evaluator),
            progress,
            anew=self.anew,
            limit=limit,
            repeats=self._options.pacing == LOCKSTEP,
        )

    def _graph_anew(self) -> AbstractContextManager[EpisodeRunner]:
        folder = self._log_folder / "again"
        folder.mkdir(parents=True, exist_ok=True)
        return graphs_session(
            replace(self._options, graphs=1),
            controller=self._car.controller,
            simulator=self._simulator,
            campaign=campaign_name(self._car),
            log_folder=folder,
            record_to=None,
        )


def rated_through_graph(
    plan: Plan,
    objectives: Sequence[Objective],
    options: GraphOptions,
    further: Further,
    *,
    log_folder: Path,
    record_to: Path | None,
    progress: Progress,
    say: Callable[[str], None],
    kept_by: Callable[[EpisodeRunner], EpisodeRunner] = lambda evaluator: evaluator,
) -> Rating:
    """Return the assessment of a plan, for which kernels have been compiled (`compile_for_graph`).

    Args:
        plan: what to assess.
        objectives: the objectives of the kamikazes.
        options: how the graph is run.
        further: what the assessment has besides the figures of its kamikazes.
        log_folder: folder for the output of the graph's processes.
        record_to: folder for one bag per episode; none: do not record.
        progress: called with how far the work is.
        say: called with one line about what was done.
        kept_by: makes of the runner of the graph's episodes one that keeps those of which figures are.

    Raises:
        UsageError: a process cannot be started.
        AssessmentError: the graph cannot go on; says where the logs are.
    """
    car, simulator, asked = plan.car, plan.simulator, plan
    fresh = fresh_process(car, simulator, options)
    run_again = RunAgain(car, simulator, options, log_folder)
    learning = DoubtsOfLearning(car, fresh, later=run_again.here or run_again.anew)
    session = graphs_session(
        options,
        controller=car.controller,
        simulator=simulator,
        campaign=campaign_name(car),
        log_folder=log_folder,
        record_to=record_to,
    )
    found: tuple[str, ...] = ()
    with session as evaluator:
        timed = TimedRunner(evaluator)
        plan = learned_plan(plan, timed, progress, say, options, learning.believed)
        # Only nodes that wait for one another can walk a way again.
        ways = timed if options.pacing == LOCKSTEP else None
        runners = Runners.of_graph(plan, kept_by(timed), timed, ways=ways, fresh=fresh)
        rating = assessed(plan, objectives, runners, progress, further)
        groups, limit = [*groups_of(rating), learning.seen], timed.limit(rating.episodes)
        if run_again.here:
            found = run_again.doubts(groups, limit, progress, evaluator)
        evaluator.publish_assessment(rating)
    if run_again.anew:
        found = run_again.doubts(groups, limit, progress)
    warnings = (*rating.warnings, *learning.found, *found)
    if learning.seen:
        keep_or_forget(asked, warnings, say, options, learning.keep_now)
    return replace(rating, warnings=warnings)
