"""`python -m skd_evaluator` is the command line `skd`."""

import sys

from skd_evaluator.start import skd

sys.exit(skd())
