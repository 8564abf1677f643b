"""Cars that were written when the margin's search was done, to try it on: no rule of it was chosen with any of them."""

import math

import numpy as np

from cars.memory import Law


class HeadwayStopAndGo(Law):
    """Keeps a time headway to a road user in its corridor, and drives on a second after the corridor is free."""

    control_period = 0.1

    def begin(self) -> None:
        self._free = 10

    def decide(self, speed: float) -> float:
        self._free = 0 if self.near(25.0, self.reach + 0.8) else self._free + 1
        if self._free == 0:
            return max(-6.0, min(1.0, 0.5 * (self.gap - 2.0 - 1.4 * speed)))
        return self.cruise(speed) if self._free >= 10 else -1.0


class SpeedProfile(Law):
    """Follows, with a PID controller, the speed from which it stops softly before a road user nearby."""

    control_period = 0.05

    def begin(self) -> None:
        self._sum = self._error = 0.0

    def decide(self, speed: float) -> float:
        room = max(0.0, self.gap - 1.5) if self.near(30.0, self.reach + 1.5) else math.inf
        before, self._error = self._error, min(self.desired, math.sqrt(6.0 * room)) - speed
        self._sum = max(-2.0, min(2.0, self._sum + self.control_period * self._error))
        rate = (self._error - before) / self.control_period
        return max(-7.0, min(1.5, 1.5 * self._error + 0.4 * self._sum + 0.05 * rate))


class DrawnReaction(Law):
    """Brakes after a reaction time that it draws anew for each road user that comes into view."""

    control_period = 0.1

    def begin(self) -> None:
        self._wait = math.nan

    def decide(self, speed: float) -> float:
        if not self.near(16.0, 3.5):
            self._wait = math.nan
            return self.cruise(speed)
        drawn = math.isnan(self._wait)
        self._wait = self.rng.lognormal(math.log(0.5), 0.4) if drawn else self._wait - self.control_period
        return -6.0 if self._wait <= 0.0 else self.cruise(speed)


class LosesTracks(Law):
    """Brakes for a road user that it has detected twice; tracks go on straight where detections fail, in bursts."""

    control_period = 0.1

    def begin(self) -> None:
        self._seen, self._lost, self._fails, self._track = 0, 0, False, (0.0, 0.0)

    def decide(self, speed: float) -> float:
        self._fails = self.rng.random() < (0.7 if self._fails else 0.1)
        if not self._fails and self.near(20.0, 6.0):
            self._seen, self._lost, self._track = self._seen + 1, 0, (self.left, self.gap)
            self._rate = self.leftwards
        else:
            left, gap = self._track
            self._track = left + 0.1 * self._rate if self._seen else left, gap - 0.1 * speed
            self._lost += 1
            self._seen = self._seen if self._lost <= 6 else 0
        left, gap = self._track
        return -6.0 if self._seen >= 2 and 0.0 < gap < 15.0 and abs(left) < self.reach + 0.9 else self.cruise(speed)


class LookUpTable(Law):
    """Takes its acceleration from a table, by time to arrival and distance aside."""

    control_period = 0.15
    TIMES, ASIDES = (0.5, 1.0, 1.6, 2.4), (1.4, 2.2, 3.2, 4.5)  # s, m
    BRAKES = np.array([[8.0, 7.0, 5.0, 3.0], [8.0, 6.0, 3.0, 1.5], [6.0, 3.0, 1.0, 0.0], [3.0, 1.0, 0.0, 0.0]])  # m/s²

    def decide(self, speed: float) -> float:
        time = int(np.searchsorted(self.TIMES, self.gap / max(speed, 0.5)))
        aside = int(np.searchsorted(self.ASIDES, abs(self.left)))
        brakes = self.gap > 0.0 and time < len(self.TIMES) and aside < len(self.ASIDES) and self.BRAKES[time, aside] > 0
        return -float(self.BRAKES[time, aside]) if brakes else self.cruise(speed)
