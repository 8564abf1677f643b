"""The controller's side of the pipe: makes controllers and copies of them, and asks them."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import io
import os
import pickle
import random
import struct
import sys
from typing import Any

import numpy as np

from skd_sim.apart.beginning import Beginning, be_main
from skd_sim.apart.copying import Copier, drawing, seed_anew
from skd_sim.apart.guard import GuardedController, GuardedSensingController, guard
from skd_sim.apart.wire import (
    COMMAND,
    COMMANDS,
    COPY,
    LOADED,
    OF_ONE,
    SCENE,
    SENSE,
    ClosedError,
    Kind,
    Op,
    answer_with,
    read_message,
    write_all,
)
from skd_sim.choices.registry import reason_of
from skd_sim.controllers import make_controller
from skd_sim.encounter.scenario import Scenario
from skd_sim.errors import AssessmentError, NoNumberError, UsageError
from skd_sim.kernels.waiting import compile_for
from skd_sim.sensors.scan import Scan
from skd_sim.state import AdversaryState, CarState, RoadUserState, Scene

_LIBC = ctypes.CDLL(None)
_BY_LINES = 1  # _IOLBF of setvbuf(3)
_COMMAND, _COPY, _FORGET, _NUMBER = Op.COMMAND.value, Op.COPY.value, Op.FORGET.value, Kind.NUMBER  # the usual, quickly


def answer_all(questions: int, answers: int) -> None:
    """Answer what comes by one descriptor by another, until the first is closed."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(line_buffering=True)  # a process that is ended prints no rest
    _have_c_print_lines()
    car = _Car()
    try:
        while True:
            message = read_message(questions)
            try:
                kind, value = car.do(message)
            except UsageError as error:
                kind, value = Kind.REFUSED, str(error)
            except NoNumberError as error:
                kind, value = Kind.NO_NUMBER, str(error)
            except BaseException as error:  # copying a user's object may raise anything
                said = f"controller {car.name}: its process failed with {reason_of(error)}"
                kind, value = Kind.FAILED, str(error) if isinstance(error, AssessmentError) else said
            write_all(answers, answer_with(kind, value))
    except ClosedError:
        with contextlib.suppress(Exception):  # a controller may have closed or replaced them
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
        _LIBC.fflush(None)
    except BaseException as error:  # of a handler of signals of the controller's own, which comes between two questions
        said = f"its own code failed between two questions with {reason_of(error)}\n"
        with contextlib.suppress(OSError):
            os.write(2, said.encode("utf-8", "backslashreplace"))
        os._exit(1)
    os._exit(0)  # whatever the controller's own threads are at


def _have_c_print_lines() -> None:
    """Have code in C print line by line, which would keep what it prints, as this goes into a pipe, until the end."""
    with contextlib.suppress(ValueError):  # of a C library that has no variable of that name
        _LIBC.setvbuf(ctypes.c_void_p.in_dll(_LIBC, "stdout"), None, _BY_LINES, ctypes.c_size_t(0))


class _Car:
    """The controllers of one name: as many copies as whoever asks holds."""

    def __init__(self) -> None:
        self._name, self._multiplier, self._main = "", 1.0, ""
        self._controllers: dict[int, GuardedController] = {}
        self._copier = Copier()
        self._compiled: type[Any] | None = None  # whose modules' kernels do not wait any more

    @property
    def name(self) -> str:
        """Name of the controller; empty before it is told."""
        return self._name

    def do(self, message: bytes) -> tuple[Kind, Any]:
        """Do what a message says; return the answer to its last operation."""
        place, end = 0, len(message)
        answer: tuple[Kind, Any] = Kind.TEXT, None
        while place < end:
            operation = message[place]
            if operation == _COMMAND:
                _, number, *numbers = COMMAND.unpack_from(message, place)
                place += COMMAND.size
                car, adversary = CarState(*numbers[:4]), AdversaryState(*numbers[4:])
                answer = _NUMBER, self._controllers[number].command(car, adversary)
            elif operation == Op.SCENE:
                _, number, *numbers, count = SCENE.unpack_from(message, place)
                place += SCENE.size
                others = struct.unpack_from(f"<{count}d", message, place)
                place += 8 * count
                car, adversary = CarState(*numbers[:4]), RoadUserState(*numbers[4:])
                seen = Scene(car, adversary, tuple(RoadUserState(*others[k : k + 5]) for k in range(0, count, 5)))
                seeing: Any = self._controllers[number]
                answer = _NUMBER, seeing.command(car, seen)
            elif operation == Op.COMMANDS:
                _, number, count = COMMANDS.unpack_from(message, place)
                place += COMMANDS.size
                states = np.frombuffer(message, np.float64, 9 * count, place).reshape(9, count).copy()
                place += states.nbytes
                answer = (
                    Kind.NUMBERS,
                    self._controllers[number].commands(CarState(*states[:4]), RoadUserState(*states[4:])),
                )
            elif operation == _COPY:
                _, number, other = COPY.unpack_from(message, place)
                place += COPY.size
                self._controllers[number] = self._copied(other)
            elif operation == _FORGET:
                self._controllers.pop(OF_ONE.unpack_from(message, place)[1], None)
                place += OF_ONE.size
            elif operation == Op.SENSE:
                _, number, *bearings, size = SENSE.unpack_from(message, place)
                place += SENSE.size
                ranges = np.frombuffer(message, np.float32, size // 4, place)
                place += size
                sensing: Any = self._controllers[number]
                sensing.sense(Scan(ranges.copy(), *bearings))
            elif operation in (Op.BEGIN, Op.RESET, Op.SEED):
                _, number, size = LOADED.unpack_from(message, place)
                place += LOADED.size
                self._load(operation, number, pickle.loads(memoryview(message)[place : place + size]))
                place += size
            else:
                _, number = OF_ONE.unpack_from(message, place)
                place += OF_ONE.size
                answer = self._say(operation, number)
        return answer

    def _load(self, operation: int, number: int, given: Any) -> None:
        if operation == Op.BEGIN:
            self._begin(given)
        elif operation == Op.RESET:
            scenario, rng = given
            self._controllers[number].reset(_frozen(scenario), rng)
        else:
            for one, seed in zip(drawing(self._controllers[number]), given, strict=False):
                seed_anew(one, seed)

    def _begin(self, beginning: Beginning) -> None:
        sys.path[:] = beginning.path
        self._name, self._multiplier, self._main = beginning.name, beginning.multiplier, beginning.main
        if beginning.modules:
            beginning.modules.be_found()

    def _say(self, operation: int, number: int) -> tuple[Kind, Any]:
        if operation == Op.MAKE:
            if self._main:
                main, self._main = self._main, ""
                be_main(main)
            made = make_controller(self._name, self._multiplier)
            if type(made) is not self._compiled:
                compile_for(made)
                self._compiled = type(made)
            try:
                controller = self._controllers[number] = guard(made, self._name)
                told = {
                    "sensing": isinstance(controller, GuardedSensingController),
                    "control_period": controller.control_period,
                    "scene": controller.takes_scene,
                    "batches": controller.takes_batches,
                }
            except UsageError:
                raise
            except BaseException as error:  # a user's attributes may raise anything
                raise UsageError(
                    f"controller {self._name}: cannot be asked which methods and attributes it has: {reason_of(error)}"
                ) from None
            return Kind.TEXT, told
        if operation == Op.GENERATORS:
            return Kind.NUMBER, sum(1 for _ in drawing(self._controllers[number]))
        if operation == Op.DRAWN:
            state = np.random.get_state(legacy=False)  # noqa: NPY002 - a user's controller may use it: does it?
            return Kind.TEXT, hashlib.sha256(f"{random.getstate()}{state}".encode()).hexdigest()
        return Kind.TEXT, None

    def _copied(self, number: int) -> GuardedController:
        try:
            controller = self._controllers[number]
            copied: GuardedController = controller.own_copy() or self._copier.copy(controller)
        except (UsageError, AssessmentError):
            raise
        except BaseException as error:  # a user's class may raise anything
            raise AssessmentError(f"controller {self._name} cannot be copied: {reason_of(error)}") from None
        return copied


def _frozen(scenario: Scenario) -> Scenario:
    """Return a scenario whose arrays cannot be written to; it is a copy already."""
    scenario.road.line.setflags(write=False)
    return scenario
