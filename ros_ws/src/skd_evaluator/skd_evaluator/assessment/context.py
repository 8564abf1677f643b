"""What every stage of an assessment is given: who runs the episodes, what is requested, who hears of the progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES, Objective
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

from skd_evaluator.assessment.options import DEFAULT_MARGIN_LIMIT, GraphOptions
from skd_evaluator.metrics.behaviour.model import Behaviour

if TYPE_CHECKING:
    from skd_evaluator.assessment.files.results import StoredResult
    from skd_evaluator.assessment.run.workers import Workers


class Runner(Protocol):
    """Runs episodes: a pool of processes, the node graph, or a Dask cluster."""

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        """Run all of `episodes` and yield their logs in the same order."""


Progress = Callable[[str, int, int], None]
"""Called with (what is being done, done, of how many)."""


def silent(_label: str, _done: int, _total: int) -> None:
    """Say nothing of the progress."""


def run_episodes(
    runner: Runner,
    episodes: Sequence[EpisodeSpec],
    label: str,
    progress: Progress,
    done: int = 0,
    total: int | None = None,
) -> Iterator[EpisodeLog]:
    """Run episodes, and report the progress: `done` of `total` (by default, all of these) before the first of them."""
    for count, log in enumerate(runner.run(episodes), start=1):
        progress(label, done + count, len(episodes) if total is None else total)
        yield log


Fresh = Callable[[], AbstractContextManager[Runner]]
"""Makes a runner that has run nothing before."""


@dataclass(frozen=True)
class RiskRequest:
    """Which risk is requested.

    Attributes:
        behaviour: the behaviour model; None: there is to be no risk.
        runs: crude crossings at each scale; None: as many as is usual.
        subset: whether there is subset simulation of a car that is not known, too.
    """

    behaviour: Behaviour | None = None
    runs: int | None = None
    subset: bool = False


@dataclass(frozen=True)
class Context:
    """What every stage is given; the same in process, through the graph, on a cluster and for recordings.

    Attributes:
        runner: runs episodes of the car under test.
        workers: compute, and run episodes that need no graph: processes of this machine or of a cluster.
        objectives: objectives of the kamikazes, at least one.
        margin_limit: how many candidates the search for the margin may drive in each trial; 0: no margin.
        earlier: result of an earlier version of the car, with whose hits the search for the margin begins; None: none.
        curve: whether kamikazes that are bounded in their deviation are run, for the vulnerability curve.
        reference: whether the car is compared with the reference drivers.
        until_width: width (m) of the interval by φ until which φ are added; None: as many as the plan says.
        risk: which risk is requested.
        progress: called with how far the work is.
        say: called with one line about what was done.
        graph: how the node graph runs; None: episodes run in process.
        repeats: whether whole episodes can be driven again, as in real time or of recordings they cannot.
        fresh: makes a runner that has run nothing before, by which a sample is run again; None: none is.
    """

    runner: Runner
    workers: Workers
    objectives: tuple[Objective, ...] = DEFAULT_OBJECTIVES
    margin_limit: int = DEFAULT_MARGIN_LIMIT
    curve: bool = False
    reference: bool = False
    until_width: float | None = None
    risk: RiskRequest = RiskRequest()
    progress: Progress = silent
    say: Callable[[str], None] = lambda _line: None
    graph: GraphOptions | None = None
    repeats: bool = True
    fresh: Fresh | None = None
    earlier: StoredResult | None = None

    @property
    def holds_commands(self) -> bool:
        """Whether the car does not answer each state, as in real time or with a quiet time: an episode takes long."""
        return self.graph is not None and not self.graph.answers_each_state


_Stage = TypeVar("_Stage", bound=Callable[[Context, Any], Any])
STAGES: Final[dict[int, Callable[[Context, Any], Any]]] = {}
"""The stages of an assessment by their place in the order; each module of the folder `stages` adds its own."""


def stage(place: int) -> Callable[[_Stage], _Stage]:
    """Make a function a stage: it is given the context and the assessment, and returns what is known after it.

    Args:
        place: where it stands in the order of all stages; no other has this number.
    """

    def add(function: _Stage) -> _Stage:
        assert place not in STAGES, place
        STAGES[place] = function
        return function

    return add
