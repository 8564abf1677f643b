"""Whether a model keeps the rules on which planner and belief rely, tried out along random episodes.

The compiled planner checks nothing: an action out of range, a state half written or a likelihood that does not fit the
observations gives wrong plans, not errors. This check finds them first, and names the function.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import CompilationError

from skd_adversary.pomdp.pomdp import Pomdp

_GUARD = 7.25e77  # stands before and behind every array that is handed out
_GUARDS = 1000
_DRAWS = 400  # observations of each of two states that are compared
_PAIRS = 5  # of states, for each action
_ENOUGH = 20  # states redrawn without one that explains what was seen: not by chance
_SIGMAS = 6.0  # such a difference, by chance, once in 10⁹ comparisons
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_CAUSE = re.compile(r"\w+Error: (.+)")
_AROUND = ("Failed in", "During:", "There are", "- Of")


class ModelError(UsageError):
    """A function of a model breaks a rule on which planner or belief rely."""


def _reason(error: Exception) -> str:
    """Return why numba refuses a function, and in which line, out of its long message."""
    lines = [line.strip() for line in _COLOURS.sub("", str(error)).splitlines()]
    # Of a call that fits none of numba's signatures, why it does not is told as errors of their own.
    causes = [cause[1] for line in lines if (cause := _CAUSE.match(line))]
    places = [i for i, line in enumerate(lines) if line.startswith('File "')]
    said = (
        causes[:1]
        or [line for line in lines[: places[0] if places else None] if line and not line.startswith(_AROUND)][:2]
    )
    where = [lines[i].rstrip(":") for i in places]
    marks = [i for i, line in enumerate(lines) if line == "^"]
    source = f": {lines[marks[-1] - 1]}" if marks and marks[-1] > 0 else ""
    return " ".join(said) + (f" ({where[-1]}{source})" if where else "")


class _Caller:
    """Calls a model's functions, and looks at what they have done."""

    def __init__(self, model: Pomdp, seed: int) -> None:
        self.model = model
        self.rng = np.random.default_rng(seed)

    def fail(self, name: str, what: str) -> ModelError:
        return ModelError(f"model {self.model.name}: {name} {what}")

    def _call(self, name: str, *arguments: Any) -> Any:
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
            given = [np.copy(a) if isinstance(a, np.ndarray) else a for a in before]
            returned = self._call(name, *given, written, self.rng)
            # What is observed may be noted in the state itself: a particle's own memory.
            if name != "observe" and any(
                (a != b).any() for a, b in zip(before, given, strict=True) if isinstance(a, np.ndarray)
            ):
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

    def number(self, name: str, *arguments: Any) -> float:
        value = self._call(name, *arguments)
        if not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self.fail(name, f"returns {value!r}, and has to return a finite number")
        return float(value)

    def step(self, state: FloatArray, action: int) -> tuple[FloatArray, bool]:
        after, returned = self.draw("step", self.model.state_dim, state, action)
        if not (isinstance(returned, tuple) and len(returned) == 2):
            raise self.fail("step", f"returns {returned!r}, and has to return (reward, whether the episode ends)")
        if not math.isfinite(returned[0]):
            raise self.fail("step", f"returns the reward {returned[0]!r} in state {state.tolist()}")
        return after, bool(returned[1])

    def observation(self, after: FloatArray, action: int) -> FloatArray:
        return self.draw("observe", self.model.observation_dim, after, action)[0]

    def likelihood(self, after: FloatArray, action: int, seen: FloatArray) -> float:
        value = self.number("likelihood", after.copy(), action, seen)
        if value < 0.0:
            raise self.fail("likelihood", f"returns {value:g} < 0 for state {after.tolist()}, seen {seen.tolist()}")
        return value

    def fitting(self, after: FloatArray, action: int, seen: FloatArray) -> float:
        """Return the likelihood in the state that the observation was drawn in."""
        value = self.likelihood(after, action, seen)
        if value == 0.0:
            raise self.fail("likelihood", f"is 0 for what observe drew: state {after.tolist()}, seen {seen.tolist()}")
        return value

    def an_action(self, state: FloatArray) -> int:
        """Return any action that makes sense in a state."""
        actions = self.legal_actions(state)
        return actions[int(self.rng.random() * len(actions))]

    def legal_actions(self, state: FloatArray) -> list[int]:
        count = self.model.action_count
        if self.model.legal is None:
            return list(range(count))
        actions = [action for action in range(count) if self._call("legal", state, action)]
        if not actions:
            raise self.fail("legal", f"allows no action in state {state.tolist()}")
        return actions

    def alike(self, state: FloatArray, redrawn: FloatArray) -> None:
        """Check that states which look alike to the planner have the same legal actions."""
        if self.model.legal is None:
            return
        allowed, others = self.legal_actions(state), self.legal_actions(redrawn)
        if allowed != others:
            action = min(set(allowed) ^ set(others))
            raise self.fail(
                "legal",
                f"tells states apart that reinvigorate does not: action {action} is legal in only one of "
                f"{state.tolist()} and {redrawn.tolist()}, drawn from it (legal must go by what is known alone, and "
                "reinvigorate keep it)",
            )

    def default_action(self, state: FloatArray) -> None:
        action = self._call("rollout_action", state, self.rng)
        last = self.model.action_count - 1
        if not isinstance(action, int) or not 0 <= action <= last:
            raise self.fail("rollout_action", f"returns {action!r}, and actions are whole numbers, 0 to {last}")
        if action not in self.legal_actions(state):
            raise self.fail("rollout_action", f"returns {action} in state {state.tolist()}, which is not legal there")


def check_model(model: Pomdp, *, episodes: int = 20, moves: int = 20, seed: int = 0) -> None:
    """Try a model's functions along episodes of random actions.

    Every array must be written whole and no further, nothing be changed that is to be read, all luck come from the
    generator, actions be in range, numbers finite. The observation that was drawn must have a positive likelihood.
    And `likelihood` must be the density that `observe` draws from, up to one factor for all states: with p and q those
    of two states after one action, f·q / (p + q) has the same mean over observations of the first as f·p / (p + q) over
    those of the second, whatever f; they are compared for f = 1 and f = p / (p + q), with a chance of 10⁻⁹ of a false
    alarm each. So are states and those that `reinvigorate` draws from them, which are to allow the same actions, and of
    which some have to explain what was seen.

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
        raise ModelError(
            f"model {model.name}: parameters is a {type(model.parameters).__name__}, and has to be a NamedTuple of "
            "numbers and arrays"
        )
    reached: dict[int, list[tuple[FloatArray, FloatArray]]] = {}
    explained = []
    for _ in range(episodes):
        state, _nothing = caller.draw("initial", model.state_dim)
        for _move in range(moves):
            caller.default_action(state)
            if model.leaf_value is not None:
                caller.number("leaf_value", state)
            action = caller.an_action(state)
            after, ended = caller.step(state, action)
            if ended:
                break
            seen = caller.observation(after, action)
            caller.fitting(after, action, seen)
            another, _nothing = caller.draw("reinvigorate", model.state_dim, after, seen)
            caller.alike(after, another)
            explained.append(caller.likelihood(another, action, seen) > 0.0)
            reached.setdefault(action, []).append((after, another))
            state = after
    if len(explained) >= _ENOUGH and not any(explained):
        raise caller.fail("reinvigorate", f"draws no state that explains what was seen, in {len(explained)} of as many")
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
    # Of what is seen in the first state and in the second: how far it speaks for the first one, by the likelihoods.
    shares = np.empty((2, _DRAWS))
    for k, (own, other) in enumerate(((first, second), (second, first))):
        for i in range(_DRAWS):
            seen = np.empty(caller.model.observation_dim)
            caller.model.observe(caller.model.parameters, own.copy(), action, seen, caller.rng)
            p, q = caller.fitting(own, action, seen), caller.likelihood(other, action, seen)
            shares[k, i] = p / (p + q) if k == 0 else q / (p + q)
    in_first, in_second = shares
    for one, two, hint in (
        (1.0 - in_first, in_second, "a factor that depends on the state, as 1/σ, may be missing"),
        (
            (1.0 - in_first) * in_first,
            in_second**2,
            "it may be surer than what is seen, or less sure: a wrong σ, or odds",
        ),
    ):
        # What is rare may be in none of the draws: the variance is taken to be at least that of one in all of them.
        error = math.sqrt(sum(max(float(some.var(ddof=1)), 1.0 / _DRAWS) for some in (one, two)) / _DRAWS)
        if abs(float(one.mean() - two.mean())) > _SIGMAS * error:
            raise caller.fail(
                "likelihood",
                f"is not the density that observe draws from: after action {action}, states {first.tolist()} and "
                f"{second.tolist()} have a wrong proportion ({hint})",
            )
