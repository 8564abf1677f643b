"""The wheel in an environment that holds nothing but it and what it asks for, away from the checkout."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
from importlib import metadata
from pathlib import Path

import pytest
from common import PATIENCE
from packaging.requirements import Requirement
from packaging_support import PYTHON_PACKAGES, ROOT

PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
SMALL = ["--safe-count", "1", "--kamikaze-count", "2", "--collision-runs", "3", "--simulations", "20", "--workers", "1"]


def run(*command: object, folder: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PYTEST"))}
    done = subprocess.run(
        list(map(str, command)), cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def asked_for(distribution: metadata.Distribution) -> dict[str, metadata.Distribution]:
    """What a distribution requires without extras, and what that requires, by name."""
    found: dict[str, metadata.Distribution] = {}
    waiting = [distribution]
    while waiting:
        for text in waiting.pop().requires or []:
            wanted = Requirement(text)
            if wanted.name in found or (wanted.marker and not wanted.marker.evaluate({"extra": ""})):
                continue
            one = metadata.distribution(wanted.name)
            assert wanted.specifier.contains(one.version, prereleases=True), f"{text}: there is {one.version}"
            found[wanted.name] = one
            waiting.append(one)
    return found


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an environment with the wheel; the packages that it asks for are those of this one, by links."""
    folder = tmp_path_factory.mktemp("wheel")
    run(*PIP, "wheel", "--no-deps", "--no-index", "--no-build-isolation", "--wheel-dir", folder, ROOT, folder=folder)
    (wheel,) = folder.glob("*.whl")
    run(sys.executable, "-m", "venv", "--without-pip", folder / "env", folder=folder)
    python = folder / "env" / "bin" / "python"
    run(*PIP, "--python", python, "install", "--no-deps", "--no-index", wheel, folder=folder)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    site = folder / "env" / "lib" / version / "site-packages"
    (installed,) = metadata.distributions(path=[str(site)])
    for one in asked_for(installed).values():
        for top in {path.parts[0] for path in one.files or ()} - {".."}:
            if not (site / top).exists():
                (site / top).symlink_to(Path(str(one.locate_file(top))))
    assert not (site / "pytest").exists()
    assert Path(sysconfig.get_path("purelib")).samefile(site) is False
    return folder / "env"


def test_it_assesses_and_reports(environment: Path, tmp_path: Path) -> None:
    skd = environment / "bin" / "skd"
    places = "; ".join(f"import {name}; print({name}.__file__)" for name in PYTHON_PACKAGES)
    for place in run(environment / "bin" / "python", "-c", places, folder=tmp_path).split():
        assert Path(place).is_relative_to(environment)
    assert "Assessment: basic" in run(skd, "assess", *SMALL, "--out", "out", folder=tmp_path)
    figures = json.loads((tmp_path / "out" / "assessment.json").read_text(encoding="utf-8"))
    assert figures["deviation"] is not None
    assert figures["provenance"]["git"] is None
    run(skd, "report", "out", "--out", "report.html", folder=tmp_path)
    assert "vega" in (tmp_path / "report.html").read_text(encoding="utf-8")
