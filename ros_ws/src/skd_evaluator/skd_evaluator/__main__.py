"""`python -m skd_evaluator` is the command line `skd`."""

import sys

from skd_evaluator.cli import main

sys.exit(main())
