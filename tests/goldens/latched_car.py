"""A car with state."""

import numpy as np
from skd_sim import AdversaryState, CarState, Scenario


class LatchedCar:
    """Brakes while the pedestrian is less than 1.1 s away, for 10 commands; then not for 20."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self._front = scenario.car.front
        self._cruise = scenario.car.start_speed
        self._left = 0

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        gap = adversary.y - car.y - self._front
        if self._left == 0 and 0.0 <= gap <= 1.1 * car.speed and abs(adversary.x - car.x) < 3.0:
            self._left = 10
        if self._left > 0:
            self._left -= 1
            if self._left == 0:
                self._left = -20
            return -5.0
        self._left = min(self._left + 1, 0)
        return 0.5 * (self._cruise - car.speed)
