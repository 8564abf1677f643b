"""A folder to run `skd` in, and `skd` in the tests' own process."""

import shutil
from pathlib import Path

import pytest
from cli_support import CONTROLLERS, CROSSING
from report_support import make_sweep


@pytest.fixture
def here(tmp_path: Path) -> Path:
    (tmp_path / "my_cars.py").write_text(CONTROLLERS)
    (tmp_path / "good.csv").write_text(CROSSING)
    return tmp_path


@pytest.fixture
def skd_here(here, skd_here):
    """`skd` in this process, in the folder `here`."""
    return skd_here


@pytest.fixture(scope="session")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small sweep: two cars over two φ."""
    return make_sweep(tmp_path_factory.mktemp("report") / "sweep")


@pytest.fixture
def result(sweep: Path, tmp_path: Path) -> Path:
    """A result of its own for each test: whoever changes it changes no other's."""
    shutil.copytree(sweep / "synthetic" / "C_1", tmp_path / "result")
    return tmp_path / "result"
