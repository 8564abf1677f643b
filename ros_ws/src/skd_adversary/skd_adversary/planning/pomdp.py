"""The model interface: a POMDP as a handful of small compiled functions.

A state is a vector of floats, an observation likewise. Actions are listed, and then an action is an index, or they are
drawn, and then it is a vector of floats, too. Every function takes the model's parameters
first and, where it draws, the generator last; results are written into the array that the caller passes, so that
planner and belief run without allocation. A model is only these functions: planners, beliefs and simulators are
separate objects, and none of them knows a model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

Action: TypeAlias = Any
"""Number of a listed action, or a vector of floats that was drawn."""


@dataclass(frozen=True)
class Pomdp:
    """⟨S, A, T, O, Z, R, γ⟩ (paper, "POMDP"), with T and R as one generative step.

    Attributes:
        name: unique per set of functions: it names the compiled planner.
        state_dim: length of a state vector.
        observation_dim: length of an observation vector.
        action_count: actions are 0 … action_count − 1; 0 where they are drawn.
        discount: γ in (0, 1]; 1 only where every episode ends.
        parameters: NamedTuple of floats and arrays that every function receives.
        initial: (parameters, state_out, rng): draw a state from the initial belief.
        step: (parameters, state, action, next_state_out, rng) → (reward, terminal).
        observe: (parameters, next_state, action, observation_out, rng): draw what is observed after the action.
        likelihood: (parameters, next_state, action, observation) → density up to a constant factor.
        rollout_action: (parameters, state, rng) → action of the default policy; where actions are drawn, (parameters,
            state, action_out, rng) writes it.
        reinvigorate: (parameters, state, observation, state_out, rng): draw a state that agrees with the
            observation and with whatever of `state` is known for sure; used when no particle explains what was seen.
        leaf_value: (parameters, state) → return to expect from a state; where given, it replaces the default policy's
            rollouts.
        leaf_parameters: what `leaf_value` and `action_value` receive instead of `parameters`; by default these.
        action_value: (parameters, state, action) → return to expect of the action if the state were seen, for rollouts
            that act by its mean over a belief (QMDP). Only PFT-DPW has such.
        legal: (parameters, state, action) → whether the action makes sense. Must depend only on what the decision maker
            knows; the search tries no other. All by default.
        action_dim: length of a drawn action; 0 where actions are listed.
        draw_action: (parameters, state, depth, tried, action_out, rng): draw an action that may be worth trying so many
            moves ahead, where so many have been tried already. It may go by what the decision maker knows alone.
    """

    name: str
    state_dim: int
    observation_dim: int
    action_count: int
    discount: float
    parameters: Any
    initial: Callable[..., None]
    step: Callable[..., tuple[float, bool]]
    observe: Callable[..., None]
    likelihood: Callable[..., float]
    rollout_action: Callable[..., int]
    reinvigorate: Callable[..., None]
    leaf_value: Callable[..., float] | None = None
    legal: Callable[..., bool] | None = None
    leaf_parameters: Any = None
    action_value: Callable[..., float] | None = None
    action_dim: int = 0
    draw_action: Callable[..., None] | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.discount <= 1.0:
            raise ValueError(f"discount of {self.name} must lie in (0, 1], got {self.discount:g}")
        if self.state_dim < 1 or self.observation_dim < 1:
            raise ValueError(f"{self.name} needs at least one state and observation dimension")
        listed, drawn = self.action_count > 0, self.action_dim > 0
        if listed == drawn or drawn != (self.draw_action is not None):
            raise ValueError(
                f"{self.name} needs either an action_count of at least one, or an action_dim and draw_action, got "
                f"action_count {self.action_count}, action_dim {self.action_dim} and "
                f"{'a' if self.draw_action else 'no'} draw_action"
            )
        if drawn and (self.legal is not None or self.action_value is not None):
            raise ValueError(f"{self.name} draws its actions: legal and action_value are for those that are listed")

    @property
    def leaves(self) -> Any:
        """What `leaf_value` receives first."""
        return self.parameters if self.leaf_parameters is None else self.leaf_parameters
