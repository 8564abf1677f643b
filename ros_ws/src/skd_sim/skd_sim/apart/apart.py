"""A user's controller in a process of its own, and copies of it there: to whoever asks them they are controllers.

The process is `skd_sim.apart.car_process`; those that this process keeps are closed by `close_all`.
"""

from __future__ import annotations

import os
import struct
from math import isfinite
from typing import Any, Final

import numpy as np

from skd_sim.apart.beginning import SentModule, SentModules
from skd_sim.apart.car_process import ApartCar, loaded
from skd_sim.apart.wire import COMMAND, COMMANDS, OF_ONE, SCENE, SENSE, Op
from skd_sim.arrays import FloatArray
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.controllers import Controller, make_controller
from skd_sim.encounter.definition import CONTROL_PERIODS
from skd_sim.encounter.scenario import Scenario
from skd_sim.errors import AssessmentError
from skd_sim.sensors.scan import Scan
from skd_sim.state import AdversaryState, CarState, Scene

_MOST: Final = 4  # processes of different controllers that are kept
_LARGEST: Final = 2**63 - 1
_MOST_GENERATORS: Final = 1_000_000  # that one keeps
_COMMAND, _FORGET = Op.COMMAND.value, Op.FORGET.value


class ApartController:
    """A controller in the process of its car; a copy of it is made there.

    Attributes:
        control_period: that it declares, s; none by default.
        takes_scene: whether it wants to see everybody.
        takes_batches: whether it answers many episodes at once.
    """

    def __init__(
        self,
        car: ApartCar,
        number: int,
        control_period: float | None,
        *,
        takes_scene: bool,
        takes_batches: bool = False,
    ) -> None:
        """Stand for the controller of a number."""
        self._car, self._number = car, number
        self.control_period, self.takes_scene, self.takes_batches = control_period, takes_scene, takes_batches

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Pass the call on; see `Controller.reset`. It gets copies of both."""
        self._car.ask(loaded(Op.RESET, self._number, (scenario, rng)))

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Pass the call on; see `Controller.command`.

        Raises:
            AssessmentError: it fails, or answers no finite number.
        """
        if isinstance(adversary, Scene):
            return self._seeing(adversary)
        return self._acceleration(self._car.ask(COMMAND.pack(_COMMAND, self._number, *car, *adversary)))

    def _acceleration(self, answer: object) -> float:
        if type(answer) is float and isfinite(answer):  # its process guards that, but it is the controller's
            return answer
        raise AssessmentError(
            f"controller {self._car.name}: its process answered with something else than an acceleration"
        )

    def commands(self, states: FloatArray) -> FloatArray:
        """Ask for the accelerations in many episodes at once; see `BatchController.commands`.

        Args:
            states: 9 × n: x, y, heading and speed of each car, x, y, vx, vy and heading of each adversary.

        Returns:
            n accelerations, m/s².

        Raises:
            AssessmentError: it fails, or answers anything but n finite numbers.
        """
        count = states.shape[1]
        question = COMMANDS.pack(Op.COMMANDS, self._number, count) + np.ascontiguousarray(states).tobytes()
        answer = self._car.ask(question)
        if not isinstance(answer, np.ndarray) or answer.shape != (count,) or not np.isfinite(answer).all():
            raise AssessmentError(
                f"controller {self._car.name}: its process answered {count} episodes with something else than their "
                "accelerations"
            )
        return answer

    def _seeing(self, scene: Scene) -> float:
        others = [number for other in scene.others for number in other]
        question = SCENE.pack(Op.SCENE, self._number, *scene.ego, *scene.adversary, len(others))
        return self._acceleration(self._car.ask(question + struct.pack(f"<{len(others)}d", *others)))

    def seed_anew(self, rng: np.random.Generator) -> None:
        """Have the generators that it keeps go on from other seeds, drawn from `rng`.

        Raises:
            AssessmentError: it keeps one that cannot be seeded.
        """
        count = self._car.ask(OF_ONE.pack(Op.GENERATORS, self._number))
        if not isinstance(count, float) or not 0 <= count <= _MOST_GENERATORS:
            raise AssessmentError(f"controller {self._car.name}: its process does not say what it draws from")
        if count:
            seeds = [int(rng.integers(_LARGEST)) for _ in range(int(count))]
            self._car.ask(loaded(Op.SEED, self._number, seeds))

    def drawn(self) -> str:
        """Return a digest of the random generators that everybody in its process has."""
        return str(self._car.ask(OF_ONE.pack(Op.DRAWN, 0)))

    def __deepcopy__(self, memo: dict[int, Any]) -> ApartController:
        made = type(self)(
            self._car,
            self._car.copy(self._number),
            self.control_period,
            takes_scene=self.takes_scene,
            takes_batches=self.takes_batches,
        )
        memo[id(self)] = made
        return made

    def __reduce__(self) -> Any:
        raise TypeError("a controller stays with the process that asks it")

    def __del__(self) -> None:
        if car := vars(self).get("_car"):
            car.add(OF_ONE.pack(_FORGET, self._number))


class ApartSensingController(ApartController):
    """The same of a controller that takes scans."""

    def sense(self, scan: Scan) -> None:
        """Pass the scan on, with the next question; see `SensingController.sense`."""
        ranges = np.asarray(scan.ranges, np.float32).tobytes()
        numbers = scan.angle_min, scan.angle_increment, scan.range_max
        self._car.add(SENSE.pack(Op.SENSE, self._number, *numbers, len(ranges)) + ranges)


def made_in(process: ApartCar) -> ApartController:
    """Make a controller in a process.

    Raises:
        UsageError: it cannot be loaded.
        AssessmentError: a controller before it has changed what its process says.
    """
    number = process.new_number()
    told = process.ask(OF_ONE.pack(Op.MAKE, number), timed=False)
    try:
        sensing, scene, batches, period = (told[name] for name in ("sensing", "scene", "batches", "control_period"))
        kind = ApartSensingController if sensing else ApartController
        period = None if period is None else float(period)
        if period is not None and not CONTROL_PERIODS[0] <= period <= CONTROL_PERIODS[1]:
            raise ValueError(period)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise AssessmentError(f"controller {process.name}: its process does not say what it is") from None
    return kind(process, number, period, takes_scene=bool(scene), takes_batches=bool(batches))


class _Kept:
    """The processes that this process keeps.

    Attributes:
        cars: processes by the names of their controllers, and whether they are those that are asked for
            confirmation; the last one used is the last.
        owner: id of the process to which these belong; 0 before there is one.
        modules: what controllers find in memory, by name.
    """

    cars: Final[dict[tuple[str, bool], ApartCar]] = {}
    owner = 0
    modules: Final[dict[str, SentModule]] = {}


def apart(car: CarUnderTest, *, confirming: bool = False) -> ApartController:
    """Make a user's controller in the process that this process keeps for it.

    Args:
        car: whose controller it is.
        confirming: in another process than any that is not, which has seen nothing of what is to be confirmed.

    Raises:
        UsageError: it cannot be loaded.
    """
    cars = _Kept.cars
    if _Kept.owner != os.getpid():  # this one was forked, and they are its parent's
        cars.clear()
        _Kept.owner = os.getpid()
    process = cars.pop((car.controller, confirming), None)
    if process is None:
        if len(cars) >= _MOST:
            cars.pop(next(iter(cars))).close()
        process = ApartCar(car, SentModules(_Kept.modules) if _Kept.modules else None)
    cars[car.controller, confirming] = process
    return made_in(process)


def controller_of(car: CarUnderTest) -> Controller:
    """Make a car's controller: SKD's own in this process, a user's apart.

    Raises:
        UsageError: it cannot be loaded.
    """
    return make_controller(car.controller, car.multiplier) if car.is_own else apart(car)


def takes_batches(car: CarUnderTest) -> bool:
    """Tell whether a user's controller answers many episodes at once.

    Raises:
        UsageError: it cannot be loaded.
    """
    return apart(car).takes_batches


def have_sent(name: str, module: SentModule) -> None:
    """Have controllers find a module in memory; those that had another one of this name begin anew."""
    if _Kept.modules.get(name) != module:
        _Kept.modules[name] = module
        close_all()


def close_all() -> None:
    """End the processes that this process keeps."""
    if _Kept.owner == os.getpid():
        for process in _Kept.cars.values():
            process.close()
    _Kept.cars.clear()


def names() -> list[str]:
    """Return the controllers of whom this process keeps a process, or has kept one."""
    return sorted({name for name, _ in _Kept.cars}) if _Kept.owner == os.getpid() else []


def pids() -> list[int]:
    """Return the ids of the processes that this process keeps, and of those that pass on what they print."""
    cars = list(_Kept.cars.values()) if _Kept.owner == os.getpid() else []
    return [pid for process in cars for pid in process.pids]
