"""A small result to export, and `skd` in the tests' own process."""

from pathlib import Path

import pytest
from common import run_skd

SIZES = [
    *("--safe-count", "2", "--kamikaze-count", "2", "--collision-runs", "2", "--simulations", "20", "--workers", "1"),
    *("--margin-limit", "0", "--behaviour", "none", "--no-pictures", "--quiet"),
]


@pytest.fixture(scope="session")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small assessment among bystanders, one of whom walks and one drives."""
    folder = tmp_path_factory.mktemp("exchange") / "result"
    assert run_skd("assess", "--scenario", "bystanders", *SIZES, "--out", folder) == 0
    return folder
