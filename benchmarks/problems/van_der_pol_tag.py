"""Van der Pol Tag: an agent between barriers looks for a target that is carried about by a Van der Pol oscillator.

As in POMCPOW's experiments (Sunberg and Kochenderfer 2018, with barriers; `zsunberg/VDPTag2.jl` of March 2018,
`icaps_2018/vdpbarrier_table.jl` of `zsunberg/ContinuousPOMDPTreeSearchExperiments.jl`). The agent starts in the origin,
the target anywhere in [−4, 4]². An action is a direction, in which the agent goes 0.5, and whether it looks, which
costs 5; it is drawn. Barriers on the axes, from 0.2 to 3 on either side of the origin, stop the agent. The target
follows ẋ = μ (x − x³/3 − y), ẏ = x/μ with μ = 2, in Runge–Kutta steps of 0.1, for 0.5, and N(0, 0.05²). A move costs 1;
where the two are then nearer than 0.1 the episode ends, with +100 instead. Eight beams of 45° are observed: the one
that holds the target reads its distance with σ = 0.1 after a look and 5 else, the others N(1, 5²). γ = 0.95.

As published, rollouts do anything, and the root's first action goes to where the target will be, by a guess of where it
is. (There by the mean of the belief; here by one of its states, which is the same as soon as the target is found.)
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel

AGENT, TARGET = 0, 2
"""Where a place begins in a state."""
LOOK, ANGLE = range(2)
"""Of an action: 1 or 0, and rad."""
BEAMS: Final = 8
DISCOUNT: Final = 0.95
_EPSILON: Final = float(np.finfo(np.float64).eps)


class VanDerPolParameters(NamedTuple):
    """Geometry, dynamics, noise, rewards."""

    mu: float = 2.0
    stride: float = 0.5
    time_step: float = 0.1
    substeps: int = 5
    spread: float = 0.05
    start: float = 4.0
    barrier_from: float = 0.2
    barrier_to: float = 3.0
    radius: float = 0.1
    sharp: float = 0.1
    blurred: float = 5.0
    other_beams: float = 1.0
    tag: float = 100.0
    move: float = -1.0
    look: float = -5.0


@kernel
def initial(parameters: VanDerPolParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Put the agent into the origin, the target anywhere."""
    state[AGENT] = state[AGENT + 1] = 0.0
    for k in range(2):
        state[TARGET + k] = parameters.start * (2.0 * rng.random() - 1.0)


@kernel(inline=True)
def drift(mu: float, x: float, y: float) -> tuple[float, float]:
    """Return the velocity of a target."""
    return mu * (x - x * x * x / 3.0 - y), x / mu


@kernel(inline=True)
def carried(parameters: VanDerPolParameters, x: float, y: float) -> tuple[float, float]:
    """Return where a target will be after a move, but for noise."""
    mu, h = parameters.mu, parameters.time_step
    for _ in range(parameters.substeps):
        x1, y1 = drift(mu, x, y)
        x2, y2 = drift(mu, x + 0.5 * h * x1, y + 0.5 * h * y1)
        x3, y3 = drift(mu, x + 0.5 * h * x2, y + 0.5 * h * y2)
        x4, y4 = drift(mu, x + h * x3, y + h * y3)
        x += h / 6.0 * (x1 + 2.0 * x2 + 2.0 * x3 + x4)
        y += h / 6.0 * (y1 + 2.0 * y2 + 2.0 * y3 + y4)
    return x, y


@kernel(inline=True)
def _share(
    parameters: VanDerPolParameters, along: float, step_along: float, across: float, step_across: float
) -> float:
    """Return the share of a step after which it meets the barriers on one axis; infinity if it does not."""
    if step_across == 0.0:
        return math.inf
    share = -across / step_across
    place = abs(along + share * step_along)
    return share if share >= 0.0 and parameters.barrier_from <= place <= parameters.barrier_to else math.inf


@kernel(inline=True)
def walked(parameters: VanDerPolParameters, x: float, y: float, angle: float) -> tuple[float, float]:
    """Return where the agent is after a move: in front of the barrier, if there is one."""
    dx, dy = parameters.stride * math.cos(angle), parameters.stride * math.sin(angle)
    share = 1.0 + 2.0 * _EPSILON
    share = min(share, _share(parameters, x, dx, y, dy))
    share = min(share, _share(parameters, y, dy, x, dx))
    share -= 2.0 * _EPSILON
    return x + share * dx, y + share * dy


@kernel(inline=True)
def step(
    parameters: VanDerPolParameters, state: FloatArray, action: FloatArray, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move both; tag the target if it is near then."""
    p = parameters
    after[AGENT], after[AGENT + 1] = walked(p, state[AGENT], state[AGENT + 1], action[ANGLE])
    x, y = carried(p, state[TARGET], state[TARGET + 1])
    after[TARGET] = x + p.spread * rng.standard_normal()
    after[TARGET + 1] = y + p.spread * rng.standard_normal()
    dx, dy = after[TARGET] - after[AGENT], after[TARGET + 1] - after[AGENT + 1]
    tagged = dx * dx + dy * dy < p.radius * p.radius
    return (p.tag if tagged else p.move) + p.look * action[LOOK], tagged


@kernel(inline=True)
def _beam(state: FloatArray) -> tuple[int, float]:
    """Return the beam that holds the target, and the target's distance."""
    dx, dy = state[TARGET] - state[AGENT], state[TARGET + 1] - state[AGENT + 1]
    angle = math.atan2(dy, dx)
    if angle <= 0.0:
        angle += 2.0 * math.pi
    return min(max(math.ceil(BEAMS * angle / (2.0 * math.pi)), 1), BEAMS) - 1, math.sqrt(dx * dx + dy * dy)


@kernel(inline=True)
def observe(
    parameters: VanDerPolParameters, state: FloatArray, action: FloatArray, seen: FloatArray, rng: np.random.Generator
) -> None:
    """Read the eight beams."""
    held, distance = _beam(state)
    for beam in range(BEAMS):
        seen[beam] = parameters.other_beams + parameters.blurred * rng.standard_normal()
    if action[LOOK] > 0.0:
        seen[held] = distance + parameters.sharp * (seen[held] - parameters.other_beams) / parameters.blurred
    else:
        seen[held] += distance - parameters.other_beams


@kernel(inline=True)
def likelihood(parameters: VanDerPolParameters, state: FloatArray, action: FloatArray, seen: FloatArray) -> float:
    """Return the density as a share of what it would be if the target were in no beam."""
    held, distance = _beam(state)
    elsewhere = (seen[held] - parameters.other_beams) / parameters.blurred
    sigma = parameters.sharp if action[LOOK] > 0.0 else parameters.blurred
    error = (seen[held] - distance) / sigma
    return math.exp(0.5 * (elsewhere * elsewhere - error * error)) * parameters.blurred / sigma


@kernel(inline=True)
def rollout_action(
    parameters: VanDerPolParameters, state: FloatArray, action: FloatArray, rng: np.random.Generator
) -> None:
    """Do anything."""
    action[LOOK] = 1.0 if rng.random() < 0.5 else 0.0
    action[ANGLE] = 2.0 * math.pi * rng.random()


@kernel(inline=True)
def towards_target(parameters: VanDerPolParameters, state: FloatArray) -> float:
    """Return the direction to where the target will be."""
    x, y = carried(parameters, state[TARGET], state[TARGET + 1])
    return math.atan2(y - state[AGENT + 1], x - state[AGENT])


@kernel(inline=True)
def draw_action(
    parameters: VanDerPolParameters,
    state: FloatArray,
    depth: int,
    tried: int,
    action: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Draw anything, but at the root first go to where the target will be."""
    rollout_action(parameters, state, action, rng)
    if depth == 0 and tried == 0:
        action[LOOK], action[ANGLE] = 0.0, towards_target(parameters, state)


@kernel
def reinvigorate(
    parameters: VanDerPolParameters, state: FloatArray, seen: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Keep the agent; the target may be anywhere."""
    initial(parameters, redrawn, rng)
    redrawn[AGENT], redrawn[AGENT + 1] = state[AGENT], state[AGENT + 1]


def van_der_pol_tag() -> Pomdp:
    """Return Van der Pol Tag."""
    return Pomdp(
        name="benchmark_van_der_pol_tag",
        state_dim=4,
        observation_dim=BEAMS,
        action_count=0,
        discount=DISCOUNT,
        parameters=VanDerPolParameters(),
        initial=initial,
        step=step,
        observe=observe,
        likelihood=likelihood,
        rollout_action=rollout_action,
        reinvigorate=reinvigorate,
        action_dim=2,
        draw_action=draw_action,
    )
