"""The options of a campaign, of an assessment and of a graph that SKD starts. Light: every command begins with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import CarUnderTest, is_own_world
from skd_sim.options.options import (
    EXTERNAL,
    GRAPH,
    LAUNCHES,
    LOCKSTEP,
    RARE,
    CommandOptions,
    EpisodeOptions,
    Lists,
    Names,
    SimulatorOptions,
    graph_option,
    option,
    options_of,
)

from skd_evaluator.metrics import behaviour

SYNTHETIC = "synthetic"
OWN = "own"
"""As synthetic, but against the car under test itself, as far as the adversary knows it."""
RECORDED = "bags"
"""What results of recordings have in its place: φ of the recorded episodes, in whatever simulator they ran."""
MAXIMUM_ABORTED = 0.05
"""Share of episodes that may be aborted before an assessment counts as failed."""
MOST_WORKERS = 1024
DEFAULT_MARGIN_LIMIT = 1024
WALKERS, NO_BEHAVIOUR = behaviour.WALKERS, behaviour.NO_BEHAVIOUR
GENERATED = (SYNTHETIC, OWN, WALKERS)
"""Sources of as many φ as are asked for."""
_CAMPAIGN: Any = {"commands": ("assess", "sweep"), "launches": ("assessment",)}


@dataclass(frozen=True, kw_only=True)
class CampaignOptions(EpisodeOptions):
    """The table of a campaign's options."""

    safe: str = option(
        SYNTHETIC,
        "source of safe trajectories: synthetic (past a basic car), own (past yours), walkers, regulatory "
        "(a protocol), or files: CITR, csv",
        metavar="SOURCE",
        group="car and test",
        commands=("assess", "episode", "drive"),
    )
    safe_count: int = option(20, "how many safe trajectories (φ) there are", within=(1, 65_535), **_CAMPAIGN)
    kamikaze_count: int = option(
        25,
        "trials of the margin, and kamikazes that hit, on each safe trajectory; at most twice as many kamikazes start",
        within=(1, 1_000_000),
        **{**_CAMPAIGN, "commands": (*_CAMPAIGN["commands"], "protocol")},
    )
    collision_runs: int = option(
        500,
        "how many runs follow a safe trajectory unchanged, for the nominal collision rate",
        within=(1, 10_000_000),
        **_CAMPAIGN,
    )
    seed: int = option(
        0,
        "number from which every random draw follows: the same seed gives the same results",
        within=(0, 2**63 - 1),
        commands=("assess", "sweep", "episode", "probe", "protocol", "drive"),
    )


@dataclass(frozen=True, kw_only=True)
class AssessmentOptions:
    """The table of what an assessment computes beside planned kamikazes."""

    margin_limit: int = option(
        DEFAULT_MARGIN_LIMIT,
        "how many candidate trajectories the search for the margin may drive in each trial. It stops earlier "
        "when the mean no longer changes. 0: no margin",
        within=(0, 1_000_000),
        commands=("assess", "sweep", "replay", "protocol", "log"),
    )
    warm_start: str = option(
        "",
        "folder of an earlier assessment: the search for the margin begins with the trajectories that hit the car then",
        metavar="DIR",
        commands=("assess",),
        unset="none",
        marks=(RARE,),
    )
    behaviour: str = option(
        WALKERS,
        "how people walk, for the risk: walkers, a file of skd fit --people, or none (no risk)",
        metavar="NAME",
        commands=("assess", "sweep", "episode"),
    )
    risk_runs: int | None = option(
        None,
        "how many crossings the risk is estimated from at each scale s",
        int,
        within=(1, 10_000_000),
        commands=("assess", "sweep"),
        unset="2000 for the basic car, 500 for others, 100 through the graph",
        marks=(RARE,),
    )
    risk_subset: bool = option(
        False,
        "use subset simulation wherever the crossings show fewer than 50 hits, whatever the car: 16000 crossings "
        "or more a scale",
        commands=("assess", "sweep"),
        marks=(RARE,),
    )
    curve: bool = option(
        False,
        "also plan kamikazes that may deviate only up to a limit, for several limits: points of the "
        "vulnerability curve",
        commands=("assess",),
        marks=(RARE,),
    )
    reference: bool = option(
        False,
        "also say between which reference drivers the car stands (UN R157's, emergency brakes, IDM), by their margins "
        "in the same trials. The first time in these trials that takes minutes",
        commands=("assess",),
    )


JUMP, INITIAL_POSE, LIFECYCLE, RESTART = "jump", "initialpose", "lifecycle", "restart"
COMPOSED, SEPARATE = "composed", "separate"
OF_NO_RESULT = frozenset({"nodes"})
"""Options that change how long it takes, and no number of what comes out."""
RESETS = (JUMP, INITIAL_POSE, LIFECYCLE, RESTART)


@dataclass(frozen=True, kw_only=True)
class EvaluatorOptions(CommandOptions):
    """The table of what the evaluator is told of the car under test."""

    control_period: float | None = graph_option(
        None,
        "time between two decisions of an external controller, s. It must divide the time step of the scenario",
        float,
        within=(0.0, 10.0),
        metavar="S",
        marks=(GRAPH, EXTERNAL, RARE),
        unset="as the scenario says",
    )
    lifecycle_nodes: str = graph_option(
        "",
        "names of the controller's managed (lifecycle) nodes, in the order in which they start, such as "
        "/planner,/guard",
        metavar="NAMES",
        unset="none",
    )


@dataclass(frozen=True, kw_only=True)
class TaskOptions:
    """The table of what the evaluator's node does before it ends."""

    task: str = option("assessment", "what to do before the node ends", choices=Names(LAUNCHES), launches=())
    mode: str = option(
        "kamikaze",
        "what the adversary does (task episode)",
        choices=Names(("safe", "kamikaze", "replay")),
        launches=("episode",),
    )
    trial: int = option(
        0, "which trial of the campaign to run (task episode)", within=(0, 2**32 - 1), launches=("episode",)
    )
    scenario: str = option("", "name of a scenario, or a YAML file", unset="the one that suits the safe trajectories")
    max_aborted: float = option(
        100.0 * MAXIMUM_ABORTED,
        "percentage of the episodes that may be aborted before the assessment counts as failed",
        within=(0.0, 100.0),
        launches=(),
    )
    silence_limit: float = option(
        120.0,
        "an episode ends after this many seconds of the wall clock without a message of the simulator",
        within=(1.0, 3600.0),
        launches=(),
    )
    record: bool = option(True, "keep a recording (a bag) of every episode")
    out: str = option("", "folder for the results", unset="skd_results/<task>-<time> in the working folder")
    overwrite: bool = option(False, "replace the results in out")


@dataclass(frozen=True, kw_only=True)
class GraphOptions(SimulatorOptions, EvaluatorOptions):
    """The table of how to run the graph. Light: every command begins with it."""

    controller_command: str | None = graph_option(
        None,
        "the shell command that starts the controller's node",
        str,
        metavar="COMMAND",
        unset="you start the controller yourself",
        launches=(),
        marks=(GRAPH, EXTERNAL),
    )
    message_folder: tuple[str, ...] | None = graph_option(
        None,
        "folder with packages of .msg files that no sourced workspace has. Can be given several times",
        tuple,
        metavar="DIR",
        unset="none",
        marks=(GRAPH, EXTERNAL, RARE),
        launches=(),
    )
    reset: str = graph_option(
        JUMP,
        "how the controller learns of a new episode: jump (of the pose), initialpose, lifecycle, restart (of its "
        "command), or several, as jump,restart",
        choices=Lists(RESETS),
        metavar="HOW",
        launches=(),
    )
    nodes: str = graph_option(
        COMPOSED,
        "where simulator and adversary run: composed (in this process, which is faster), or separate. Real time "
        "and quiet_time are always separate",
        choices=Names((COMPOSED, SEPARATE)),
        launches=(),
        commands=("assess", "episode", "probe"),
    )

    @property
    def resets(self) -> tuple[str, ...]:
        """How the controller learns that a new episode begins."""
        return tuple(self.reset.split(","))

    @property
    def answers_each_state(self) -> bool:
        """Whether every state certainly gets a command of its own."""
        return self.pacing == LOCKSTEP and self.quiet_time is None

    def composes(self, simulator: str) -> bool:
        """Return whether simulator and adversary share the evaluator's process, if that is a simulator's name."""
        # Planning may take longer than a control period, and other simulators need processes of their own.
        return self.nodes == COMPOSED and self.answers_each_state and is_own_world(simulator)

    def simulator_parameters(self) -> dict[str, Any]:
        """Return the parameters of the simulator's node by name."""
        values = {one.name: one.plain(getattr(self, one.name)) for one in options_of(SimulatorOptions)}
        return {**values, "initial_pose": self.initial_pose or INITIAL_POSE in self.resets}

    def check(self, car: CarUnderTest) -> None:
        """Refuse options that do not go together.

        Args:
            car: the car under test.

        Raises:
            UsageError: some do not.
        """
        started_here = not car.is_external or self.controller_command is not None
        if RESTART in self.resets and not started_here:
            raise UsageError("reset restart needs --controller-command: SKD restarts only what it has started")
        if (LIFECYCLE in self.resets) != bool(managed_nodes(self.lifecycle_nodes)):
            raise UsageError("reset lifecycle and lifecycle_nodes /name,/other go together: give both or neither")


def managed_nodes(names: str) -> tuple[str, ...]:
    """Return the full names of the nodes in the text of option lifecycle_nodes."""
    return tuple(f"/{name.strip().lstrip('/')}" for name in names.split(",") if name.strip())
