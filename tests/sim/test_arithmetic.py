"""A digest of what this machine's arithmetic gives: always the same here, another where one bit is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from skd_sim.kernels.compilation import arithmetic_digest


@pytest.mark.parametrize(("module", "name"), [(math, "sin"), (math, "lgamma"), (np, "exp"), (np, "arctan2")])
def test_one_bit_in_one_value_of_one_function_is_another_digest(monkeypatch, module, name):
    before, function, calls = arithmetic_digest(), getattr(module, name), []

    def off_by_one_bit(*arguments):
        calls.append(arguments)
        exact = function(*arguments)
        if isinstance(exact, float):
            return math.nextafter(exact, math.inf) if len(calls) == 500 else exact
        exact[500] = np.nextafter(exact[500], np.inf)
        return exact

    monkeypatch.setattr(module, name, off_by_one_bit)
    assert arithmetic_digest() != before
