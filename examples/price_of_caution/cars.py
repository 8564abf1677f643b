"""Cars whose safety costs something, and cars whose safety costs nothing: of each the price is known beforehand.

scripts/skd campaign examples/price_of_caution/campaign.yaml --out skd_results/price
scripts/skd compare skd_results/price
"""


class NeverBrakes:
    """Keeps its speed, whoever comes."""

    def reset(self, scenario, rng):
        """Take the speed from the scenario."""
        self.speed = scenario.car.start_speed

    def command(self, car, adversary):
        """Return the acceleration (m/s²)."""
        return 0.0

    def towards(self, car, speed):
        """Return what brings it gently to a speed."""
        return max(-3.5, min(2.0, speed - car.speed))


class HalfSpeed(NeverBrakes):
    """Drives at half speed, and never brakes."""

    def command(self, car, adversary):
        """Return the acceleration (m/s²)."""
        return max(-3.5, min(2.0, (0.5 * self.speed - car.speed) / 0.3))  # within a tick of 0.3 s


class BrakesForEverybody(NeverBrakes):
    """Stops for whoever is ahead, in its way or not."""

    def command(self, car, adversary):
        """Return the acceleration (m/s²)."""
        return -3.5 if adversary.y > car.y - 10.0 else 0.0


class BrakesByTimeToCollision(NeverBrakes):
    """Brakes hard where somebody will be in its way when it gets there within 1.4 s."""

    def command(self, car, adversary):
        """Return the acceleration (m/s²)."""
        gap = adversary.y - car.y - 2.25
        if gap < 0.0 or car.speed <= 0.0:
            return self.towards(car, self.speed)
        time = gap / car.speed
        comes = time < 1.4 and abs(adversary.x + adversary.vx * time) < 1.5
        return -7.0 if comes else self.towards(car, self.speed)


class StopsAndWaits(NeverBrakes):
    """Stops gently for whoever is on the road or near the kerb, waits for five seconds, and goes on."""

    def reset(self, scenario, rng):
        """Take the speed from the scenario."""
        super().reset(scenario, rng)
        self.edge = 0.5 * scenario.road.lane_width + 2.0
        self.waited = 0.0

    def command(self, car, adversary):
        """Return the acceleration (m/s²)."""
        gap = adversary.y - car.y - 2.25
        if self.waited >= 5.0 or not 0.0 < gap < 4.0 + car.speed**2 / 4.0 or abs(adversary.x) > self.edge:
            return self.towards(car, self.speed)
        if car.speed == 0.0:
            self.waited += 0.3
        return -2.0
