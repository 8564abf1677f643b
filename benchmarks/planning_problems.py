"""The problems of the planning benchmark: models, the planners' options there, and published figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import numpy as np
from problems.crossing import crossing
from problems.laser_tag import laser_tag, random_cells
from problems.light_dark import light_dark, light_dark_at_random, light_dark_observed, light_dark_rollouts
from problems.rock_sample import rock_sample
from problems.sub_hunt import sub_hunt, sub_hunt_at_random, sub_hunt_with_leaves
from problems.tag import tag
from problems.tiger import tiger
from problems.van_der_pol_tag import van_der_pol_tag
from skd_adversary.model.parts import SEARCH
from skd_adversary.planning.general.pft_dpw import PftDpwOptions
from skd_adversary.planning.general.pomcpow import PomcpowOptions
from skd_adversary.planning.options import Backup, Cells, PlannerOptions
from skd_adversary.planning.pomdp import Pomdp


@dataclass(frozen=True)
class Problem:
    """What is measured.

    Attributes:
        make: seed of the episode → model.
        options: of the planner; `simulations` is the default budget.
        moves: an episode is cut off after so many.
        planning_model: model of the same states that the planner plans on, the default policy's advantages being its
            rewards; the problem's own by default.
        published: figures to compare with: source → (mean return, standard error or None).
        pomdp_py: name in `problems.pomdp_py_models`, or None where pomdp-py is not run.
        others: planner → its options, where they are not those of `options`.
        others_model: model that planners other than ours plan on; ours' by default.
        bin_width: of continuous observations for pomdp-py.
        pomdp_py_episodes: default number of episodes of pomdp-py.
    """

    make: Callable[[int], Pomdp]
    options: PlannerOptions
    moves: int
    published: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    planning_model: Callable[[], Pomdp] | None = None
    pomdp_py: str | None = None
    others: dict[str, PlannerOptions] = field(default_factory=dict)
    others_model: Callable[[], Pomdp] | None = None
    bin_width: float = 1.0
    pomdp_py_episodes: int = 20


# Observations that repeat exactly: each has a child of its own.
_DISCRETE: Final[dict[str, Any]] = {"cells": Cells.NEAREST, "observation_factor": math.inf}
# Leaves have the exact value of a good policy: the mean of the action tried most is neither spoilt by what else was
# tried nor by luck.
_EXACT_LEAVES: Final[dict[str, Any]] = {**_DISCRETE, "backup": Backup.MOST_VISITED}


def _widening(factor: float, exponent: float) -> dict[str, float]:
    return {"observation_factor": factor, "observation_exponent": exponent}


def _action_widening(factor: float, exponent: float) -> dict[str, float]:
    return {"action_factor": factor, "action_exponent": exponent}


def converted(options: PlannerOptions, kind: type[PlannerOptions], **changed: Any) -> PlannerOptions:
    """Return options of another planner, the same as far as they mean something to it, but for those given here."""
    return kind(**{f.name: getattr(options, f.name) for f in fields(PlannerOptions)} | changed)


def _pft_dpw(options: PlannerOptions) -> dict[str, PlannerOptions]:
    """Return PFT-DPW's options where none are published: ours, but for the widening that a belief a node needs."""
    return {"pft_dpw": converted(options, PftDpwOptions, **_widening(4.0, 0.1))}


def _published(
    depth: int, particles: int, *, pomcpow: Mapping[str, Any], pft_dpw: Mapping[str, Any]
) -> dict[str, PlannerOptions]:
    """Return the options of the published experiments."""
    both: dict[str, Any] = {"depth": depth, "particles": particles}
    return {"pomcpow": PomcpowOptions(**both, **pomcpow), "pft_dpw": PftDpwOptions(**both, **pft_dpw)}


_TIGER: Final = PlannerOptions(
    # The default policy listens, whatever the state: rollouts have no optimism, and need not learn any.
    simulations=5_000,
    depth=25,
    exploration=110.0,
    particles=1_000,
    learned_states=0,
    **_DISCRETE,
)
_ROCK_SAMPLE: Final = PlannerOptions(simulations=5_000, depth=60, exploration=1.0, particles=3_000, **_EXACT_LEAVES)
_LASER_TAG: Final = {"exploration": 26.0} | _widening(4.0, 1.0 / 35.0)
_LIGHT_DARK: Final = PlannerOptions(simulations=10_000, depth=20, exploration=100.0, particles=3_000)
_SUB_HUNT: Final = PlannerOptions(simulations=20_000, depth=20, exploration=100.0, particles=10_000)
_TAG: Final = PlannerOptions(simulations=1_000, depth=90, exploration=1.0, particles=2_000, **_EXACT_LEAVES)
PROBLEMS: dict[str, Problem] = {
    "tiger": Problem(
        lambda _seed: tiger(),
        _TIGER,
        others=_pft_dpw(_TIGER),
        moves=150,
        published={"optimum": (19.37, None)},
        pomdp_py="tiger",
    ),
    "rock_sample_7_8": Problem(
        lambda _seed: rock_sample(7, 8),
        _ROCK_SAMPLE,
        others=_pft_dpw(_ROCK_SAMPLE),
        planning_model=lambda: rock_sample(7, 8, advantages=True),
        moves=100,
        published={
            "DESPOT C++, 1 s a move": (21.68, 1.19),
            "DESPOT C++, 0.1 s": (20.24, 0.76),
            "DESPOT, published": (20.9, None),
            "ABT (TAPIR), 0.1 s": (19.40, 1.23),
        },
        pomdp_py="rock_sample",
        pomdp_py_episodes=2,
    ),
    "rock_sample_11_11": Problem(
        lambda _seed: rock_sample(11, 11),
        _ROCK_SAMPLE,
        others=_pft_dpw(_ROCK_SAMPLE),
        planning_model=lambda: rock_sample(11, 11, advantages=True),
        moves=100,
        published={
            "DESPOT C++, 0.1 s": (20.59, 1.21),
            "DESPOT, published": (21.8, None),
            "ABT (TAPIR), 0.1 s": (17.46, 1.34),
        },
    ),
    "tag": Problem(
        lambda _seed: tag(),
        _TAG,
        others=_pft_dpw(_TAG),
        planning_model=lambda: tag(advantages=True),
        moves=90,
        published={
            "DESPOT C++, 1 s": (-4.47, 1.21),
            "DESPOT C++, 0.1 s": (-7.16, 0.58),
            "ABT (TAPIR), 0.1 s": (-5.60, 1.12),
            "DESPOT, published": (-6.2, None),
            "POMCP, published": (-7.1, None),
        },
        pomdp_py="tag",
        pomdp_py_episodes=10,
    ),
    # The planner's rewards are the problem's own, not advantages.
    "tag_plain_rewards": Problem(
        lambda _seed: tag(),
        replace(_TAG, simulations=5_000),
        moves=90,
    ),
    "laser_tag": Problem(
        lambda seed: laser_tag(random_cells(np.random.default_rng([seed, 0]))),
        PlannerOptions(
            simulations=3_000,
            depth=90,
            exploration=5.0,
            particles=8_000,
            observation_factor=4.0,
            observation_exponent=0.1,
            backup=Backup.MOST_VISITED,
            cells=Cells.NEAREST,
        ),
        moves=90,
        published={
            "DESPOT C++, 0.1 s": (-6.96, 1.25),
            "DESPOT, published": (-8.9, 0.2),
            "POMCPOW, published": (-10.3, 0.2),
        },
        others=_published(
            90,
            8_000,
            pomcpow={"simulations": 3_000, "most_visited": True} | _LASER_TAG,
            pft_dpw={"simulations": 1_000} | _LASER_TAG,
        ),
    ),
    "light_dark": Problem(
        lambda _seed: light_dark(),
        replace(_LIGHT_DARK, backup=Backup.MOST_VISITED, cells=Cells.NEAREST, **_widening(4.0, 0.2)),
        moves=100,
        published={
            "POMCPOW, published": (56.1, 0.6),
            "PFT-DPW, published": (57.2, 0.5),
            "POMCP, binned observations, published": (61.1, 0.4),
        },
        others_model=light_dark_observed,
        others=_published(
            20,
            10_000,
            pomcpow={"simulations": 20_000, "exploration": 90.0} | _widening(5.0, 1.0 / 15.0),
            pft_dpw={"simulations": 5_000, "exploration": 100.0} | _widening(4.0, 0.1),
        ),
        pomdp_py="light_dark",
        bin_width=1.0,
    ),
    "light_dark_rollouts": Problem(
        lambda _seed: light_dark_rollouts(),
        _LIGHT_DARK,
        moves=100,
    ),
    "light_dark_at_random": Problem(
        lambda _seed: light_dark_at_random(),
        _LIGHT_DARK,
        moves=100,
    ),
    "sub_hunt": Problem(
        lambda _seed: sub_hunt(),
        _SUB_HUNT,
        planning_model=sub_hunt_with_leaves,
        moves=100,
        published={
            "PFT-DPW, published": (77.4, 1.1),
            "POMCPOW, published": (69.2, 1.3),
            "QMDP, published": (28.0, 1.3),
            "ping first, then QMDP, published": (79.0, 1.1),
        },
        others=_published(
            20,
            10_000,
            pomcpow={"simulations": 20_000, "exploration": 17.0, "most_visited": True, "ends_are_seen": False}
            | _widening(6.0, 0.01),
            pft_dpw={"simulations": 5_000, "exploration": 100.0} | _widening(2.0, 0.1),
        ),
    ),
    "sub_hunt_rollouts": Problem(
        lambda _seed: sub_hunt(),
        _SUB_HUNT,
        moves=100,
        pomdp_py="sub_hunt",
        bin_width=2.0,
    ),
    "sub_hunt_at_random": Problem(
        lambda _seed: sub_hunt_at_random(),
        _SUB_HUNT,
        moves=100,
    ),
    # Actions are drawn. The published experiments had one second of a core in 2018.
    "van_der_pol_tag": Problem(
        lambda _seed: van_der_pol_tag(),
        PlannerOptions(simulations=20_000, depth=10, particles=10_000, **_action_widening(30.0, 1.0 / 30.0)),
        moves=100,
        published={
            "POMCPOW, published": (29.3, 0.8),
            "PFT-DPW, published": (27.2, 0.8),
            "a look where uncertain, published": (-2.7, 1.2),
        },
        others=_published(
            10,
            10_000,
            pomcpow={"simulations": 50_000, "exploration": 110.0, "ends_are_seen": False}
            | _widening(5.0, 1.0 / 100.0)
            | _action_widening(30.0, 1.0 / 30.0),
            pft_dpw={"simulations": 20_000, "exploration": 70.0}
            | _widening(8.0, 1.0 / 85.0)
            | _action_widening(20.0, 1.0 / 25.0),
        ),
    ),
    "crossing": Problem(
        lambda _seed: crossing(),
        replace(SEARCH, simulations=1_000, exploration=30.0),
        moves=25,
        pomdp_py="crossing",
        pomdp_py_episodes=5,
    ),
}
