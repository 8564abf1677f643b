"""What of the adapter to MetaDrive needs no MetaDrive: its pedals' arithmetic, and what it says where there is none."""

import importlib.metadata

import numpy as np
import pytest
from common import refused
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.controllers.controller import make_controller
from skd_sim.simulators.metadrive.pedals import MeasuredPedal, Pedals
from skd_sim.simulators.simulator import make_simulator, repeats_itself

PEDALS = Pedals(
    tuple(MeasuredPedal(one, -20.0 * min(one, 0.4) - 5.0 * max(0.0, one - 0.4)) for one in Pedals.BRAKES),
    tuple(MeasuredPedal(one, 2.5 * one) for one in Pedals.THROTTLES),
    -0.3,
)


@given(st.floats(-11.0, 2.5))
def test_an_acceleration_comes_back(acceleration: float) -> None:
    pedal = PEDALS.pedal(acceleration)
    assert -1.0 <= pedal <= 1.0
    assert pedal != 0.0  # with no pedal at all MetaDrive's cars roll against a brake
    assert PEDALS.acceleration(pedal) == pytest.approx(acceleration, abs=1e-4)


def test_more_brake_that_does_less_is_level() -> None:
    less = Pedals((MeasuredPedal(0.5, -8.0), MeasuredPedal(1.0, -7.0)), (MeasuredPedal(1.0, 2.0),), -0.3)
    assert less.limits.least == -8.0
    assert less.pedal(-8.0) >= -1.0
    assert less.acceleration(-1.0) == -8.0
    assert np.all(np.diff([less.acceleration(one) for one in np.linspace(-1.0, -1e-3, 50)]) >= 0.0)


@pytest.mark.parametrize("version", [None, "0.3.0.1"])
def test_without_metadrive_one_line_says_how_to_install_it(monkeypatch, version: str | None) -> None:
    def found(name: str) -> str:
        if version is None:
            raise importlib.metadata.PackageNotFoundError(name)
        return version

    monkeypatch.setattr(importlib.metadata, "version", found)
    for make in (
        lambda: make_simulator("metadrive"),
        lambda: repeats_itself("metadrive"),
        lambda: make_controller("metadrive_expert"),
    ):
        with refused("MetaDrive 0.4.3, and ", "pip install metadrive-simulator==0.4.3", version or "not installed"):
            make()
