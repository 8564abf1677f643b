"""The model interface, a POMDP as a handful of small compiled functions, and a check that a model keeps to its rules.

A state is a vector of floats, an observation likewise, an action an index. Every function takes the model's parameters
first and, where it draws, the generator last; results are written into the array that the caller passes, so that
planner and belief run without allocation. A model is only these functions: planners, beliefs and simulators are
separate objects, and none of them knows a model.

The compiled planner checks nothing: an action out of range, a state half written or a likelihood that does not fit the
observations gives wrong plans, not errors. `check_model` finds them first, along random episodes, and names the
function.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import CompilationError
from skd_sim.world.state import FloatArray


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


_GUARD = 7.25e77  # stands before and behind every array that is handed out
_GUARDS = 1000
_DRAWS = 400  # observations of each of two states that are compared
_PAIRS = 5  # of states, for each action
_SIGMAS = 6.0  # such a difference, by chance, once in 10⁹ comparisons


class ModelError(UsageError):
    """A function of a model breaks a rule on which planner or belief rely."""


def _reason(error: Exception) -> str:
    """Return why numba refuses a function, and in which line, out of its long message."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    causes = re.findall(r"\w+Error: (.+)", text) or text.splitlines()[1:2]
    places = re.findall(r'File "[^"]+", line \d+', text)
    return " ".join(causes[:1]) + (f" ({places[-1]})" if places else "")


class _Caller:
    """Calls a model's functions, and looks at what they have done."""

    def __init__(self, model: Pomdp, seed: int) -> None:
        self.model = model
        self.rng = np.random.default_rng(seed)

    def fail(self, name: str, what: str) -> ModelError:
        return ModelError(f"model {self.model.name}: {name} {what}")

    def call(self, name: str, *arguments: Any) -> Any:
        function = getattr(self.model, name)
        if not hasattr(function, "py_func"):
            raise self.fail(name, "is not compiled: decorate it with @kernel (skd_sim.kernels.compilation)")
        first = self.model.leaves if name == "leaf_value" else self.model.parameters
        try:
            return function(first, *arguments)
        except TypeError as error:  # before anything is compiled
            raise self.fail(name, f"takes other arguments: {error}") from error
        except CompilationError as error:
            raise self.fail(name, f"does not compile: {_reason(error)}") from error

    def draw(self, name: str, length: int, *before: Any) -> tuple[FloatArray, Any]:
        """Call a random function twice, with equal generators; return what it wrote and what it returned."""
        results = []
        luck = self.rng.bit_generator.state
        for _ in range(2):
            self.rng.bit_generator.state = luck
            memory = np.full(length + 2 * _GUARDS, _GUARD)
            written = memory[_GUARDS : _GUARDS + length]
            written[:] = np.nan
            given = [np.copy(one) if isinstance(one, np.ndarray) else one for one in before]
            returned = self.call(name, *given, written, self.rng)
            # What is observed may be noted in the state itself: a particle's own memory.
            if name != "observe" and any(np.any(a != b) for a, b in zip(before, given, strict=True)):
                raise self.fail(name, "changes an array that it is to read")
            if (np.delete(memory, np.s_[_GUARDS : _GUARDS + length]) != _GUARD).any():
                raise self.fail(name, f"writes more than the {length} numbers of its array")
            if not np.isfinite(written).all():
                missing = np.flatnonzero(~np.isfinite(written)).tolist()
                raise self.fail(name, f"leaves entries {missing} of its array unwritten, or not finite")
            results.append((written, returned))
        if results[0][1] != results[1][1] or (results[0][0] != results[1][0]).any():
            raise self.fail(name, "gives two results from one seed: draw from the generator that is handed in alone")
        return results[0]

    def step(self, state: FloatArray, action: int) -> tuple[FloatArray, bool]:
        after, returned = self.draw("step", self.model.state_dim, state, action)
        if not (isinstance(returned, tuple) and len(returned) == 2):
            raise self.fail("step", f"returns {returned!r}, and has to return (reward, whether the episode ends)")
        if not math.isfinite(returned[0]):
            raise self.fail("step", f"returns the reward {returned[0]!r} in state {state.tolist()}")
        return after, bool(returned[1])

    def number(self, name: str, *arguments: Any, drawn: bool = False) -> float:
        """Return a likelihood, or the value of a leaf; of what was drawn in a state the former is positive there."""
        value = self.call(name, *(one.copy() if isinstance(one, np.ndarray) else one for one in arguments))
        if not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self.fail(name, f"returns {value!r}, and has to return a finite number")
        if name == "likelihood" and (value < 0.0 or (drawn and value == 0.0)):
            raise self.fail(name, f"is {value:g} in state {arguments[0].tolist()}, seen {arguments[2].tolist()}")
        return float(value)

    def legal_actions(self, state: FloatArray) -> list[int]:
        """Return the legal actions of a state, after a look at the default policy's."""
        count = self.model.action_count
        legal = [one for one in range(count) if self.model.legal is None or self.call("legal", state, one)]
        action = self.call("rollout_action", state.copy(), self.rng)
        if not isinstance(action, int) or not 0 <= action < count:
            raise self.fail("rollout_action", f"returns {action!r}, and actions are whole numbers, 0 to {count - 1}")
        if action not in legal:
            raise self.fail("rollout_action", f"returns {action} in state {state.tolist()}, which is not legal there")
        return legal


def check_model(model: Pomdp, *, episodes: int = 20, moves: int = 20, seed: int = 0) -> None:
    """Try a model's functions along episodes of random actions.

    Every array must be written whole and no further, nothing be changed that is to be read, all luck come from the
    generator, actions be in range, numbers finite. The observation that was drawn must have a positive likelihood.
    And `likelihood` must be the density that `observe` draws from, up to one factor for all states: with p and q those
    of two states after one action, f·q / (p + q) has the same mean over observations of the first as f·p / (p + q) over
    those of the second, whatever f; they are compared for f = 1 and f = p / (p + q), with a chance of 10⁻⁹ of a false
    alarm each.

    Args:
        model: the model to try.
        episodes: number of episodes, each of which begins with a state that `initial` draws.
        moves: greatest number of moves in an episode.
        seed: seed of the random draws.

    Raises:
        ModelError: it says which function does what.
    """
    caller = _Caller(model, seed)
    if not isinstance(model.parameters, tuple):
        kind = type(model.parameters).__name__
        raise caller.fail("parameters", f"is a {kind}, and has to be a NamedTuple of numbers and arrays")
    reached: dict[int, list[tuple[FloatArray, FloatArray]]] = {}
    for _ in range(episodes):
        state, _nothing = caller.draw("initial", model.state_dim)
        for _move in range(moves):
            legal = caller.legal_actions(state)
            if model.leaf_value is not None:
                caller.number("leaf_value", state)
            action = legal[int(caller.rng.random() * len(legal))]
            after, ended = caller.step(state, action)
            if ended:
                break
            seen, _nothing = caller.draw("observe", model.observation_dim, after, action)
            caller.number("likelihood", after, action, seen, drawn=True)
            another, _nothing = caller.draw("reinvigorate", model.state_dim, after, seen)
            reached.setdefault(action, []).append((after, another))
            state = after
    for action, found in sorted(reached.items()):
        states = [after for after, _ in found]
        # States of two episodes may differ in all that is seen: those redrawn differ in what is hidden alone.
        apart = list(zip(states[:-1:2], states[1::2], strict=False))[:_PAIRS]
        hidden = [(after, another) for after, another in found if (after != another).any()][:_PAIRS]
        for first, second in apart + hidden:
            _compare(caller, action, first, second)


def _compare(caller: _Caller, action: int, first: FloatArray, second: FloatArray) -> None:
    """Raise where the likelihoods of two states are not in the proportion of the densities they are observed with."""
    if (first == second).all():
        return
    # Of what is seen in either state: how far it speaks for that state, by the likelihoods.
    shares = np.empty((2, _DRAWS))
    for k, (own, other) in enumerate(((first, second), (second, first))):
        for i in range(_DRAWS):
            seen = np.empty(caller.model.observation_dim)
            caller.model.observe(caller.model.parameters, own.copy(), action, seen, caller.rng)
            p = caller.number("likelihood", own, action, seen, drawn=True)
            q = caller.number("likelihood", other, action, seen)
            shares[k, i] = p / (p + q)
    in_first, in_second = shares
    for one, two, hint in (
        (1.0 - in_first, 1.0 - in_second, "a factor that depends on the state, as 1/σ, may be missing"),
        (
            (1.0 - in_first) * in_first,
            (1.0 - in_second) ** 2,
            "it may be surer than what is seen, or less sure: a wrong σ, or odds",
        ),
    ):
        # What is rare may be in none of the draws: the variance is taken to be at least that of one in all of them.
        error = math.sqrt(sum(max(float(some.var(ddof=1)), 1.0 / _DRAWS) for some in (one, two)) / _DRAWS)
        if abs(float(one.mean() - two.mean())) > _SIGMAS * error:
            what = f"after action {action}, states {first.tolist()} and {second.tolist()} are in a wrong proportion"
            raise caller.fail("likelihood", f"is not the density that observe draws from: {what} ({hint})")
