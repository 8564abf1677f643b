"""Cars that remember, draw, or look no further than they must: those that a search for their margin finds hardest.

Each is a law in a few lines, as a user might bring it; they decide every 0.05 to 0.3 s.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import AdversaryState, CarState

from cars.catalogue import Car


class Law:
    """What these cars have in common: what they see, and how they keep their speed.

    Attributes:
        gap: from the front to the road user's centre, m.
        left: of the car's axis, m.
        leftwards: velocity to the left, m/s.
    """

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take shapes and speed from the scenario, and forget all."""
        self._front, self.reach = scenario.car.front, scenario.car.half_width + scenario.adversary.reach
        self.desired, self.rng = scenario.car.start_speed, rng
        self.begin()

    def begin(self) -> None:
        """Forget all."""

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²)."""
        ahead, self.left = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
        self.along, self.leftwards = to_car_frame(adversary.vx, adversary.vy, 0.0, 0.0, car.heading)
        self.gap = ahead - self._front
        return self.decide(car.speed)

    def decide(self, speed: float) -> float:
        """Return the acceleration (m/s²) at a speed (m/s)."""
        raise NotImplementedError

    def near(self, gap: float, aside: float) -> bool:
        """Tell whether the road user is ahead, and so near (m)."""
        return 0.0 < self.gap < gap and abs(self.left) < aside

    def cruise(self, speed: float, share: float = 1.0) -> float:
        """Return the acceleration that keeps a share of the desired speed, m/s²."""
        return max(-1.0, min(1.0, share * self.desired - speed))

    @property
    def speed_of_user(self) -> float:
        """Speed of the road user, m/s."""
        return math.hypot(self.along, self.leftwards)


class Slow(Law):
    """Drives at a share of the speed, and brakes."""

    SHARE = 0.5

    def decide(self, speed: float) -> float:
        return -5.0 if self.near(6.0, self.reach + 1.0) else self.cruise(speed, self.SHARE)


class Prompt(Law):
    """Brakes at once for whoever is within its stopping distance."""

    control_period = 0.1
    ROOM = 1.5

    def decide(self, speed: float) -> float:
        return -6.0 if self.near(speed**2 / 12.0 + self.ROOM, self.reach + 1.2) else self.cruise(speed)


class Delayed(Law):
    """Does what it decided some decisions ago."""

    DECISIONS = 2

    def begin(self) -> None:
        self._wanted = [0.0] * self.DECISIONS

    def decide(self, speed: float) -> float:
        self._wanted.append(-5.0 if self.near(14.0, 4.0) else 0.0)
        return self._wanted.pop(0)


class Blinks(Law):
    """Once it brakes it brakes on for some decisions, and then sees nothing for some."""

    BRAKES, BLIND = 4, 3

    def begin(self) -> None:
        self._left = 0

    def decide(self, speed: float) -> float:
        if self._left == 0 and self.near(10.0, 3.0):
            self._left = self.BRAKES + self.BLIND
        self._left = max(0, self._left - 1)
        return -6.0 if self._left >= self.BLIND else self.cruise(speed)


class Detector(Law):
    """Sees the road user with some probability."""

    control_period = 0.15
    PROBABILITY = 0.8

    def decide(self, speed: float) -> float:
        seen = self.rng.random() < self.PROBABILITY
        return -5.0 if seen and self.near(15.0, 4.5) else self.cruise(speed)


class Tracker(Law):
    """Filters the offset, and brakes if the road user will be in the lane."""

    control_period = 0.1
    GAIN = 0.5

    def begin(self) -> None:
        self._offset, self._rate = math.nan, 0.0

    def decide(self, speed: float) -> float:
        foreseen = self.left if math.isnan(self._offset) else self._offset + 0.1 * self._rate
        self._offset = foreseen + self.GAIN * (self.left - foreseen)
        self._rate += self.left - foreseen
        time = self.gap / max(speed, 0.5)
        nearest = min(abs(self._offset + self._rate * time), abs(self._offset))
        return -6.5 if 0.0 < self.gap < 30.0 and time < 2.5 and nearest < self.reach + 0.4 else self.cruise(speed)


class Camera(Law):
    """Sees within an angle and a distance."""

    ANGLE = math.radians(30.0)

    def decide(self, speed: float) -> float:
        seen = abs(math.atan2(self.left, self.gap + self._front)) < self.ANGLE
        return -5.0 if seen and self.near(13.0, 5.0) else self.cruise(speed)


class Confirms(Law):
    """Brakes after some decisions in a row with somebody in its corridor."""

    control_period = 0.1
    DECISIONS = 3

    def begin(self) -> None:
        self._count = 0

    def decide(self, speed: float) -> float:
        inside = 0.0 < self.gap < 18.0 and abs(self.left + 0.5 * self.leftwards) < self.reach + 0.5
        self._count = self._count + 1 if inside else 0
        return -7.0 if self._count >= self.DECISIONS else self.cruise(speed)


class Waits(Law):
    """Stops for a second, and goes on."""

    control_period = 0.3

    def begin(self) -> None:
        self._stood = 0

    def decide(self, speed: float) -> float:
        if self._stood < 4 and self.near(12.0, 4.0):
            self._stood += speed < 0.3
            return -5.0
        return self.cruise(speed)


class OverlooksStanding(Law):
    """Overlooks for five ticks whoever stood for two."""

    REACH = 14.0

    def begin(self) -> None:
        self._stood = self._overlooks = 0

    def decide(self, speed: float) -> float:
        self._stood = self._stood + 1 if self.speed_of_user < 0.05 else 0
        self._overlooks = 5 if self._stood >= 2 else max(0, self._overlooks - 1)
        return -5.0 if not self._overlooks and -1.0 < self.gap < self.REACH and abs(self.left) < 6.0 else 0.0


class OverlooksAlong(Law):
    """Overlooks for some ticks whoever has walked along the road for three."""

    TICKS = 5

    def begin(self) -> None:
        self._walked = self._overlooks = 0

    def decide(self, speed: float) -> float:
        self._walked = self._walked + 1 if abs(self.leftwards) < 0.1 and abs(self.along) > 0.5 else 0
        self._overlooks = self.TICKS if self._walked >= 3 else max(0, self._overlooks - 1)
        return -5.0 if not self._overlooks and -1.0 < self.gap < 14.0 and abs(self.left) < 6.0 else 0.0


class CrossingTime(Law):
    """Brakes if the road user will be in the lane when the car is there, and for three decisions then."""

    def begin(self) -> None:
        self._left = 0

    def decide(self, speed: float) -> float:
        time = self.gap / max(speed, 0.1)
        conflict = abs(self.left + self.leftwards * time) < self.reach + 0.7 or abs(self.left) < self.reach + 0.3
        if self.gap > -5.0 and conflict and time < 2.2:
            self._left = 3
        self._left = max(-1, self._left - 1)
        return -5.5 if self._left >= 0 else self.cruise(speed)


class Hysteresis(Law):
    """Emergency brake by time to collision, which ends later than it begins."""

    control_period = 0.05

    def begin(self) -> None:
        self._brakes = False

    def decide(self, speed: float) -> float:
        aside = abs(self.left) - self.reach
        time = self.gap / max(speed, 1e-3)
        comes = self.left * self.leftwards < 0.0 and aside < (time + 0.6) * abs(self.leftwards)
        near = self.gap > -8.0 and (aside < 0.6 or (aside < 2.5 and comes))
        self._brakes = near and (time < 1.6 or (self._brakes and time <= 2.6))
        return -6.0 if self._brakes else 0.0


class Turns(Law):
    """Brakes late for whoever turns round sharply."""

    def begin(self) -> None:
        self._direction = math.nan

    def decide(self, speed: float) -> float:
        before, self._direction = self._direction, math.nan
        if self.speed_of_user > 0.05:
            self._direction = math.atan2(self.leftwards, self.along)
        turn = math.remainder(self._direction - before, 2.0 * math.pi)  # nan: it stood
        return -5.0 if self.near(7.0 if abs(turn) >= 0.5 else 14.0, 4.0) else self.cruise(speed)


class CarefulDriver(Law):
    """The attentive human driver of UN Regulation No. 157: perceives a cut-in, and brakes 0.75 s later for good."""

    control_period = 0.1
    WANDER, DELAY, RAMP, MOST = 0.375, 0.75, 0.6, 0.774 * 9.81  # m, s, s, m/s²

    def begin(self) -> None:
        self._first, self._since = math.nan, 0.0

    def decide(self, speed: float) -> float:
        self._first = abs(self.left) if math.isnan(self._first) else max(self._first, abs(self.left))
        time = self.gap / max(speed - self.along, 0.1)
        cuts_in = abs(self.left) < self._first - self.WANDER and abs(self.left) < self.reach + 1.0
        if self._since > 0.0 or (cuts_in and self.gap > 0.0 and time < 2.0):
            self._since += self.control_period
        share = max(0.0, min(1.0, (self._since - self.DELAY) / self.RAMP))
        return -share * self.MOST if share else self.cruise(speed)


class PromptFar(Prompt):
    """Keeps more room."""

    ROOM = 3.0


class Sluggish(Delayed):
    """Reacts later."""

    DECISIONS = 4


class PoorDetector(Detector):
    """Sees less often."""

    PROBABILITY = 0.5


class OverlooksWhileAlong(OverlooksAlong):
    """Sees the road user as soon as it walks otherwise."""

    TICKS = 1


class OverlooksStandingFar(OverlooksStanding):
    """Brakes from further away."""

    REACH = 25.0


_LAWS = (
    Slow, Prompt, PromptFar, Delayed, Sluggish, Blinks, Detector, PoorDetector, Tracker, Camera, Confirms, Waits,
    OverlooksStanding, OverlooksStandingFar, OverlooksAlong, OverlooksWhileAlong, CrossingTime, Hysteresis, Turns,
)  # fmt: skip
MEMORY_CARS = (
    *(
        Car(
            law.__name__, (law.__mro__[1] if law.__mro__[1] is not Law else law).__name__, f"cars.memory:{law.__name__}"
        )
        for law in _LAWS
    ),
    Car("CarefulDriver", "CarefulDriver", "cars.memory:CarefulDriver", scenario_name="cut_in"),
)
"""Twenty cars of fifteen families."""
