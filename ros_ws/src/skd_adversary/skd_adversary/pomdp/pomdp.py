"""The model interface: a POMDP as a handful of small compiled functions.

A state is a vector of floats, an observation likewise, an action an index. Every function takes the model's parameters
first and, where it draws, the generator last; results are written into the array that the caller passes, so that
planner and belief run without allocation. A model is only these functions: planners, beliefs and simulators are
separate objects, and none of them knows a model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Pomdp:
    """⟨S, A, T, O, Z, R, γ⟩ (paper, "POMDP"), with T and R as one generative step.

    Attributes:
        name: unique per set of functions: it names the compiled planner.
        state_dim: length of a state vector.
        observation_dim: length of an observation vector.
        action_count: actions are 0 … action_count − 1.
        discount: γ in (0, 1]; 1 only where every episode ends.
        parameters: NamedTuple of floats and arrays that every function receives.
        initial: (parameters, state_out, rng): draw a state from the initial belief.
        step: (parameters, state, action, next_state_out, rng) → (reward, terminal).
        observe: (parameters, next_state, action, observation_out, rng): draw what is observed after the action.
        likelihood: (parameters, next_state, action, observation) → density up to a constant factor.
        rollout_action: (parameters, state, rng) → action of the default policy.
        reinvigorate: (parameters, state, observation, state_out, rng): draw a state that agrees with the
            observation and with whatever of `state` is known for sure; used when no particle explains what was seen.
        leaf_value: (parameters, state) → return to expect from a state; where given, it replaces the default policy's
            rollouts.
        leaf_parameters: what `leaf_value` receives instead of `parameters`; by default these.
        legal: (parameters, state, action) → whether the action makes sense. Must depend only on what the decision maker
            knows; the search tries no other. All by default.
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

    def __post_init__(self) -> None:
        if not 0.0 < self.discount <= 1.0:
            raise ValueError(f"discount of {self.name} must lie in (0, 1], got {self.discount:g}")
        if self.state_dim < 1 or self.observation_dim < 1:
            raise ValueError(f"{self.name} needs at least one state and observation dimension")
        if self.action_count < 1:
            raise ValueError(f"{self.name} needs at least one action, got action_count {self.action_count}")

    @property
    def leaves(self) -> Any:
        """What `leaf_value` receives first."""
        return self.parameters if self.leaf_parameters is None else self.leaf_parameters
