"""An episode in another simulator, which reports car and pedestrian several times within each tick.

The counterpart of `World`: there the motion is computed, here it is watched. Contact is looked for between frames as in
the world, so that both mean the same by it.
"""

from __future__ import annotations

from skd_sim.episode import Episode, Outcome
from skd_sim.errors import UsageError
from skd_sim.geometry import first_contact, to_car_frame
from skd_sim.state import CarState, PedestrianState
from skd_sim.world import Contact, make_world


class FramedEpisode:
    """Counts frames into ticks and finds the first contact.

    Attributes:
        episode: the specification.
        start_car: where the car has to be put, with its draw.
        start_pedestrian: where the pedestrian has to be put.
        car: state at the last tick.
        pedestrian: state at the last tick.
        tick: number of the last tick.
        contact: in the tick that has just ended, if any.
    """

    def __init__(self, episode: Episode, frame_step: float) -> None:
        """Draw the start as the world does.

        Args:
            episode: what to run.
            frame_step: time between frames, s.

        Raises:
            UsageError: a tick is not a whole number of frames, the road has curves or the adversary is a box.
        """
        time_step = episode.scenario.time_step
        self.frames_per_tick = round(time_step / frame_step)
        if self.frames_per_tick < 1 or abs(self.frames_per_tick * frame_step - time_step) > 1e-9:
            raise UsageError(
                f"frame_step {frame_step:g} s must divide the scenario's time_step {time_step:g} s; "
                f"set it to {time_step / max(1, self.frames_per_tick):g} here and in the simulator"
            )
        if not episode.scenario.road.straight or episode.scenario.pedestrian.is_box:
            raise UsageError(
                f"scenario {episode.scenario.name} has a curved road or an adversary that is a box, which another "
                "simulator cannot be told yet; take a straight road and a disc, or SKD's own world"
            )
        world = make_world(episode)
        self.episode = episode
        self.start_car, self.start_pedestrian = world.car, world.pedestrian
        self.car, self.pedestrian = world.car, world.pedestrian
        self.tick = 0
        self.contact: Contact | None = None
        self._frame = 0
        self._before = (world.car, world.pedestrian)

    def begin(self, car: CarState, pedestrian: PedestrianState) -> None:
        """Take the states in which both have been put as those of tick 0."""
        self.car, self.pedestrian = car, pedestrian
        self._before = (car, pedestrian)

    def frame(self, car: CarState, pedestrian: PedestrianState, velocity: tuple[float, float]) -> bool:
        """Take the next frame and return whether the tick has ended with it.

        A tick ends early at a contact: what the simulator does to a pedestrian that has been hit is no part of its
        trajectory, which ends where its own command would have taken it by the end of the tick.

        Args:
            car: now.
            pedestrian: now.
            velocity: commanded to the pedestrian in this tick, m/s.
        """
        scenario = self.episode.scenario
        touched = self._touch(car, pedestrian)
        self._frame += 1
        self._before = (car, pedestrian)
        self.contact = None
        if touched is not None and touched.speed >= scenario.collision.minimum_impact_speed:
            self.contact = Contact((self._frame - 1 + touched.fraction) / self.frames_per_tick, touched.speed)
            pedestrian = PedestrianState(
                self.pedestrian.x + scenario.time_step * velocity[0],
                self.pedestrian.y + scenario.time_step * velocity[1],
                *velocity,
            )
        elif self._frame < self.frames_per_tick:
            return False
        self.car, self.pedestrian = car, pedestrian
        self.tick += 1
        self._frame = 0
        return True

    @property
    def outcome(self) -> Outcome:
        """How the episode stands at the last tick."""
        return self.episode.outcome(self.tick, self.pedestrian, collided=self.contact is not None)

    def _touch(self, car: CarState, pedestrian: PedestrianState) -> Contact | None:
        """Return the first contact since the frame before: its fraction of the frame and the car's speed."""
        before, walker = self._before
        footprint, radius = self.episode.scenario.car, self.episode.scenario.pedestrian.reach
        fraction = first_contact(
            *to_car_frame(walker.x, walker.y, before.x, before.y, before.heading),
            *to_car_frame(pedestrian.x, pedestrian.y, car.x, car.y, car.heading),
            footprint.front,
            footprint.rear,
            footprint.half_width,
            radius,
        )
        return Contact(fraction, before.speed + fraction * (car.speed - before.speed)) if fraction <= 1.0 else None
