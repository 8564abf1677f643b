"""The process of a user's controller: it knows the controller's name and what a car knows, and answers.

What it is to load, what it is asked and what it answers goes by two pipes (`skd_sim.apart.wire`).
"""

from __future__ import annotations

import sys

from skd_sim.apart.seclusion import seclude
from skd_sim.kernels.waiting import put_off
from skd_sim.program.lasting import import_lasting
from skd_sim.program.places import places_put_off


def main() -> None:
    """Answer until the pipe is closed; its two descriptors are the arguments."""
    seclude()
    places_put_off()
    questions, answers = (int(argument) for argument in sys.argv[1:])
    del sys.argv[1:]
    put_off()
    answering = import_lasting("skd_sim.apart.answering")  # imports start threads, which are to be secluded as well
    answering.answer_all(questions, answers)
