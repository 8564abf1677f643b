"""A model's mistakes are named before anything is planned on it."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from models import ring, tiger
from skd_adversary.pomdp.model import ModelError, check_model
from skd_sim.kernels.compilation import kernel


@pytest.mark.parametrize("model", [tiger(), tiger(gaussian=True), ring()], ids=["tiger", "gaussian tiger", "ring"])
def test_models_without_a_mistake(model: Any) -> None:
    check_model(model)


def not_compiled(p: Any, s: Any, a: Any, after: Any, rng: Any) -> Any:
    return -1.0, False


@kernel
def does_not_compile(p: Any, s: Any, a: Any, after: Any, rng: Any) -> Any:
    after[0] = p.no_such_number
    return -1.0, False


@kernel
def writes_too_much(p: Any, s: Any, a: Any, after: Any, rng: Any) -> Any:
    after[0] = after[1] = s[0]
    return -1.0, False


@kernel
def writes_nothing(p: Any, s: Any, a: Any, after: Any, rng: Any) -> Any:
    return -1.0, True


@kernel
def changes_the_state(p: Any, s: Any, a: Any, after: Any, rng: Any) -> Any:
    s[0] = 1.0 - s[0]
    after[0] = s[0]
    return -1.0, False


@kernel
def luck_of_its_own(p: Any, s: Any, a: Any, after: Any, rng: Any) -> Any:
    after[0] = np.random.random()  # noqa: NPY002 - the mistake in question
    return -1.0, False


@pytest.mark.parametrize(
    ("step", "what"),
    [
        (not_compiled, "step is not compiled: decorate it with @kernel"),
        (does_not_compile, "step does not compile: .*no_such_number.*test_model_check"),
        (writes_too_much, "step writes more than the 1 numbers"),
        (writes_nothing, r"step leaves entries \[0\] of its array unwritten"),
        (changes_the_state, "step changes an array that it is to read"),
        (luck_of_its_own, "step gives two results from one seed"),
    ],
)
def test_steps_with_a_mistake(step: Any, what: str) -> None:
    with pytest.raises(ModelError, match="model wrong: " + what):
        check_model(replace(tiger(), name="wrong", step=step))


@kernel
def action_three(p: Any, s: Any, rng: Any) -> int:
    return 3


@kernel
def last_alone(p: Any, s: Any, action: int) -> bool:
    return action == 2


@kernel
def zero(p: Any, s: Any, a: int, seen: Any) -> float:
    return 0.0


@kernel
def no_number(p: Any, s: Any) -> float:
    return math.nan


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"rollout_action": action_three}, "rollout_action returns 3, and actions are whole numbers, 0 to 2"),
        ({"legal": last_alone}, r"rollout_action returns 0 in state \[[01].0\], which is not legal there"),
        ({"likelihood": zero}, "likelihood is 0 in state"),
        ({"leaf_value": no_number}, "leaf_value returns nan"),
        ({"observation_dim": 2}, r"observe leaves entries \[1\]"),
    ],
)
def test_other_mistakes(change: dict[str, Any], what: str) -> None:
    with pytest.raises(ModelError, match="model wrong: " + what):
        check_model(replace(tiger(), name="wrong", **change))


@kernel
def blurred_where_it_is_dark(p: Any, s: Any, a: int, seen: Any, rng: Any) -> None:
    seen[0] = s[0] + (1.0 + s[0]) * rng.standard_normal()


@kernel
def with_its_factor(p: Any, s: Any, a: int, seen: Any) -> float:
    sigma = 1.0 + s[0]
    return 7.0 * math.exp(-0.5 * ((seen[0] - s[0]) / sigma) ** 2) / sigma


@kernel
def without_its_factor(p: Any, s: Any, a: int, seen: Any) -> float:
    sigma = 1.0 + s[0]
    return 7.0 * math.exp(-0.5 * ((seen[0] - s[0]) / sigma) ** 2)


def test_a_likelihood_that_lacks_a_factor() -> None:
    """σ is 1 in one state and 2 in the other; a factor that both have in common does not matter."""
    model = replace(tiger(), name="wrong", observe=blurred_where_it_is_dark, likelihood=with_its_factor)
    check_model(model)
    with pytest.raises(ModelError, match="likelihood is not the density that observe draws from"):
        check_model(replace(model, likelihood=without_its_factor))


@kernel
def half_as_wide(p: Any, s: Any, a: int, seen: Any) -> float:
    return math.exp(-0.5 * ((seen[0] - s[0]) / (0.5 * p.sigma)) ** 2)


def test_a_likelihood_that_is_surer_than_what_is_seen() -> None:
    """The same wrong σ in all states: no state is favoured, and the belief is too sure."""
    with pytest.raises(ModelError, match=r"likelihood is not the density .* \(it may be surer"):
        check_model(replace(ring(), name="wrong", likelihood=half_as_wide))
