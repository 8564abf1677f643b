"""How far car models differ when they brake, and what they cost.

Stopping distances (m) of the multi-body car, of the single-track drift model and of the closed form v²/2a with the
deceleration a that command and grip allow. The drift model is that of commonroad-vehicle-models with the same vehicle,
tyres and friction, integrated by SciPy's LSODA. It has neither brake delay nor anti-lock brake, so the multi-body car
is driven without them, too. A second table adds what a real stop has: delay, build-up and anti-lock brake.
Then the time that one simulated second takes.

    python benchmarks/dynamics.py [--json]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from skd_sim.dynamics.multi_body import SPEED
from skd_sim.dynamics.multi_body_car import MultiBodyCar
from skd_sim.dynamics.vehicle import BMW_320I, GRAVITY, TYRE
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.state import CarState

try:
    from vehiclemodels.init_mb import init_mb
    from vehiclemodels.init_std import init_std
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
    from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std
    from vehiclemodels.vehicle_parameters import setup_vehicle_parameters
except ModuleNotFoundError as error:
    raise SystemExit(f"dynamics.py: {error.name} is not installed: pip install -e .[benchmark]") from error

_SPEEDS = (25.0 / 3.0, 50.0 / 3.6, 60.0 * 0.44704)  # m/s: 30 km/h, 50 km/h, 60 mph
_FRICTIONS = (1.0, 0.65, 0.3)
_COMMANDS = (2.0, 4.0, 6.0)  # m/s², times friction: the wheels turn, for the drift model has no way to stay locked
_STOPPED = 0.3  # m/s from which the rest of the way is v²/2a: the models' switches at low speed are left out
_INERTIA = 1.0 + 4.0 * BMW_320I.I_y_w / (BMW_320I.m * BMW_320I.R_w**2)  # our brake allows for the wheels' spin


def _parameters(friction: float) -> Any:
    parameters = setup_vehicle_parameters(2)
    for name in ("p_hx1", "p_vx1", "r_vy1"):
        setattr(parameters.tire, name, 0.0)
    parameters.tire.p_dx1 *= friction
    parameters.tire.p_dy1 *= friction
    return parameters


def _scenario(friction: float, **changes: Any) -> Scenario:
    base = load_scenario("crossing_multi_body")
    car = replace(base.car, acceleration_noise=0.0, **changes)
    return replace(base, road=replace(base.road, friction=friction), car=car)


def _drift_distance(friction: float, speed: float, command: float) -> float:
    parameters = _parameters(friction)

    def slow(_: float, x: Any) -> float:
        return float(x[3] - _STOPPED)

    slow.terminal = True  # type: ignore[attr-defined]

    solution = solve_ivp(
        lambda _, x: vehicle_dynamics_std(x.tolist(), [0.0, -command], parameters),
        (0.0, 60.0),
        np.array(init_std([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0], parameters), dtype=float),
        method="LSODA",
        rtol=1e-6,
        atol=1e-6,
        events=slow,
    )
    return float(solution.y[0, -1])


def _multi_body_distance(scenario: Scenario, speed: float, command: float) -> float:
    car = MultiBodyCar(scenario)
    car.reset(CarState(0.0, 0.0, 0.0, speed))
    rng = np.random.default_rng(0)
    while True:
        path = car.advance(-command, scenario.time_step, car.draw(rng))
        if path[-1, 3] <= _STOPPED:
            return float(np.interp(_STOPPED, path[::-1, 3], path[::-1, 0]))


def _differences() -> list[dict[str, float]]:
    rows = []
    for speed in _SPEEDS:
        for friction in _FRICTIONS:
            for command in (friction * command for command in _COMMANDS):
                scenario = _scenario(friction, brake_delay=0.0, brake_rate=1000.0, antilock=False)
                multi_body = _multi_body_distance(scenario, speed, command / _INERTIA)
                drift = _drift_distance(friction, speed, command)
                deceleration = min(command / _INERTIA, friction * TYRE.p_dx1 * GRAVITY)
                closed = (speed**2 - _STOPPED**2) / (2.0 * deceleration)
                rows.append({
                    "speed": speed, "friction": friction, "command": command, "multi_body": multi_body,
                    "drift": drift, "closed_form": closed, "drift_error": drift / multi_body - 1.0,
                    "closed_form_error": closed / multi_body - 1.0,
                })  # fmt: skip
    return rows


def _full_stops() -> list[dict[str, float]]:
    rows = []
    for speed in _SPEEDS:
        for friction in _FRICTIONS:
            scenario = _scenario(friction)
            full = scenario.car.brake_limit
            rows.append({
                "speed": speed, "friction": friction,
                "with_delay": _multi_body_distance(scenario, speed, full),
                "without_delay": _multi_body_distance(replace(scenario, car=replace(
                    scenario.car, brake_delay=0.0, brake_rate=1000.0)), speed, full),
                "locked": _multi_body_distance(replace(scenario, car=replace(
                    scenario.car, brake_delay=0.0, brake_rate=1000.0, antilock=False)), speed, full),
                "closed_form": speed**2 / (2.0 * friction * TYRE.p_dx1 * GRAVITY),
            })  # fmt: skip
    return rows


def _seconds(work: Callable[[], object]) -> float:
    """Wall time of the fastest of five runs, s."""
    best = math.inf
    for _ in range(5):
        begin = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - begin)
    return best


def _costs() -> dict[str, float]:
    """Milliseconds per simulated second: braking at 3.5 m/s² from 20 m/s, steps of 1 ms."""
    parameters = _parameters(1.0)

    def package() -> None:
        """Runge-Kutta of fourth order, the package's right-hand side, a tenth of a second."""
        x = np.array(init_mb([0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0], parameters), dtype=float)

        def f(state: Any) -> Any:
            return np.array(vehicle_dynamics_mb(state.tolist(), [0.0, -3.5], parameters))

        for _ in range(100):
            k1 = f(x)
            k2 = f(x + 0.0005 * k1)
            k3 = f(x + 0.0005 * k2)
            k4 = f(x + 0.001 * k3)
            x += 0.001 / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    car, rng = MultiBodyCar(_scenario(1.0)), np.random.default_rng(0)

    def ours(yaw_rate: float) -> Callable[[], None]:
        def run() -> None:
            car.reset(CarState(0.0, 0.0, 0.0, 20.0))
            car.state[5] = yaw_rate
            car.advance(-3.5, 3.0, car.draw(rng))

        return run

    ours(0.0)()
    ours(0.01)()
    assert car.state[SPEED] < 20.0
    return {
        "package": 10.0 * _seconds(package) * 1e3,
        "full": _seconds(ours(0.01)) / 3.0 * 1e3,
        "straight": _seconds(ours(0.0)) / 3.0 * 1e3,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    result = {"differences": _differences(), "full_stops": _full_stops(), "ms_per_simulated_second": _costs()}
    if arguments.json:
        print(json.dumps(result, indent=2))
        return
    print("braking without delay or anti-lock brake, m    multi-body    drift          closed form")
    for row in result["differences"]:
        print(
            f"  {row['speed']:5.2f} m/s  friction {row['friction']:4.2f}  command {row['command']:4.1f} m/s²"
            f"  {row['multi_body']:9.2f}  {row['drift']:8.2f} {row['drift_error']:+6.1%}"
            f"  {row['closed_form']:8.2f} {row['closed_form_error']:+6.1%}"
        )
    print("full braking, m             delay 0.1 s, anti-lock   anti-lock   wheels locked   closed form")
    for row in result["full_stops"]:
        print(
            f"  {row['speed']:5.2f} m/s  friction {row['friction']:4.2f}  {row['with_delay']:19.2f}"
            f"  {row['without_delay']:10.2f}  {row['locked']:14.2f}  {row['closed_form']:12.2f}"
        )
    cost = result["ms_per_simulated_second"]
    print(
        f"ms per simulated second: package in Python {cost['package']:.0f}, ours {cost['full']:.1f}, "
        f"ours going straight {cost['straight']:.2f}"
    )


if __name__ == "__main__":
    main()
