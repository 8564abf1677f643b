"""Says in one line what the installed executables miss, before a test waits for them in vain."""

import pytest
from skd_sim.start import remedy_for_executables


def pytest_configure():
    """End the run where they cannot start."""
    missing = remedy_for_executables()
    if missing:
        raise pytest.UsageError(missing)
