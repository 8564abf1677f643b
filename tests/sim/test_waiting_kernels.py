"""Kernels that wait for numba give what kernels give, whoever uses them first."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from skd_sim.geometry.motion import next_speed

NUMBERS = (8.3, -2.7, 0.03, 0.1)
_BEGINNING = """
import copy, json, sys
from skd_sim.kernels import waiting
waiting.put_off()
from skd_sim.geometry import motion
from skd_sim.geometry.motion import next_speed as held
assert type(held) is waiting.Waiting and held.__name__ == "next_speed" and "numba" not in sys.modules
kept = {"it": held, "copied": copy.deepcopy(held)}
numbers = tuple(json.loads(sys.argv[1]))
"""
_END = """
assert type(motion.next_speed) is not waiting.Waiting and held is motion.next_speed and not waiting.is_put_off()
from skd_sim.geometry import contact  # what is imported later is a kernel at once
assert type(contact.rectangle_distance) is type(held)
print([one(*numbers).hex() for one in (held, kept["it"], kept["copied"])] + [kept["it"].py_func(*numbers).hex()])
"""


@pytest.mark.parametrize(
    "first",
    [
        "held(*numbers)",
        "held.py_func",
        "import numba\n@numba.njit('f8(f8)')\ndef theirs(speed): return held(speed, -2.7, 0.03, 0.1)\ntheirs(8.3)",
        "class Car:\n    __module__ = motion.__name__\nwaiting.compile_for(Car())",
    ],
    ids=["a call", "a part of it", "somebody else's kernel", "a class beside kernels"],
)
def test_whatever_comes_first_makes_all_of_them_kernels(first: str) -> None:
    program = f"{_BEGINNING}\n{first}\n{_END}"
    done = subprocess.run(
        [sys.executable, "-c", program, json.dumps(NUMBERS)], capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    assert done.stdout.strip() == str([next_speed(*NUMBERS).hex()] * 4)
