"""What the hazard network learns: a substitute for the label of a hazard stop, which was never published.

The car's *stopping zone* is the ground that it cannot help covering: as wide as the car, from the front bumper to
where it stands if it reacts for one tick and then brakes fully, and 1 m more. An adversary is **on a collision course
within braking range** if its disc, kept at its present velocity, meets the zone before the car would stand. The label
is the same with a small margin in space and time, about what the scans leave uncertain: so that a network that asks to
be 90 % sure of the label does not miss the collision course itself.
"""

from __future__ import annotations

from skd_sim.kernels.compilation import kernel
from skd_sim.world.contact import first_contact

REACTION_TIME = 0.3  # s: one tick
STANDOFF = 1.0  # m ahead of the bumper that stay free
MARGIN = 0.1  # m around the zone, of the label
MARGIN_TIME = 0.08  # s that the label follows the course for longer


@kernel
def stopping_zone(speed: float, deceleration: float) -> float:
    """Return how far (m) the stopping zone reaches ahead of the bumper.

    Args:
        speed: speed of the car, m/s.
        deceleration: deceleration of the car at full brake, m/s² (> 0).
    """
    return speed * REACTION_TIME + speed * speed / (2.0 * deceleration) + STANDOFF


@kernel
def time_to_stand(speed: float, deceleration: float) -> float:
    """Return the time (s) from now to standstill, the reaction included; arguments as `stopping_zone`."""
    return REACTION_TIME + speed / deceleration


@kernel
def on_collision_course(
    ahead: float,
    left: float,
    velocity_ahead: float,
    velocity_left: float,
    speed: float,
    half_width: float,
    radius: float,
    deceleration: float,
    margin: float,
    margin_time: float,
) -> bool:
    """Return whether an adversary's course meets the stopping zone before the car would stand.

    Args:
        ahead: how far the adversary's centre is ahead of the front bumper, m.
        left: how far the adversary's centre is to the left of the car's axis, m.
        velocity_ahead: velocity of the adversary over ground, along the car's axis, m/s.
        velocity_left: velocity of the adversary over ground, to the left, m/s.
        speed: speed of the car, m/s.
        half_width: half width of the car, m.
        radius: radius of the adversary, m.
        deceleration: deceleration of the car at full brake, m/s² (> 0).
        margin: by how much the zone is widened, m; 0 for the collision course itself.
        margin_time: by how much longer the course is followed, s; 0 for the collision course itself.
    """
    horizon = time_to_stand(speed, deceleration) + margin_time
    reach = stopping_zone(speed, deceleration) + margin
    ahead_after, left_after = ahead + horizon * velocity_ahead, left + horizon * velocity_left
    contact = first_contact(ahead, left, ahead_after, left_after, reach, 0.0, half_width + margin, radius)
    return contact <= 1.0
