"""What an index gets: what is in the sdist and the wheel, and the wheel in an environment away from the checkout.

`scripts/release` does more, which needs a network: it installs the wheel into an empty environment.
"""

import json
import os
import subprocess
import sys
import tarfile
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from common import PATIENCE
from packaging.requirements import Requirement
from packaging_support import PYTHON_PACKAGES, ROOT, tracked

SMALL = ["--safe-count", "1", "--kamikaze-count", "2", "--collision-runs", "3", "--simulations", "20", "--workers", "1"]
SMALL += ["--margin-limit", "8", "--behaviour", "none"]


def run(*command: object, folder: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PYTEST"))}
    done = subprocess.run(
        list(map(str, command)), cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sdist, unpacked."""
    folder = tmp_path_factory.mktemp("sdist")
    run(sys.executable, "-m", "hatchling", "build", "-d", folder, "-t", "sdist", folder=ROOT)
    (archive,) = folder.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        file.extractall(folder, filter="data")
    (unpacked,) = (path for path in folder.iterdir() if path.is_dir())
    return unpacked


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built of the sdist as an index does."""
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "hatchling", "build", "-d", folder, "-t", "wheel", folder=sdist)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def environment(wheel: Path) -> Path:
    """An environment with the wheel; the packages that it asks for are those of this one, by links."""
    place = wheel.parent / "env"
    run(sys.executable, "-m", "venv", "--without-pip", place, folder=wheel.parent)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", place / "bin" / "python"]
    run(*pip, "install", "--no-deps", "--no-index", wheel, folder=wheel.parent)
    site = next(place.glob("lib/python*/site-packages"))
    (installed,) = metadata.distributions(path=[str(site)])
    waiting, met = [installed], set()
    while waiting:
        for text in waiting.pop().requires or []:
            wanted = Requirement(text)
            if wanted.name in met or (wanted.marker and not wanted.marker.evaluate({"extra": ""})):
                continue
            one = metadata.distribution(wanted.name)
            assert wanted.specifier.contains(one.version, prereleases=True), f"{text}: there is {one.version}"
            met.add(wanted.name)
            waiting.append(one)
            for top in {path.parts[0] for path in one.files or ()} - {".."}:
                if not (site / top).exists():
                    (site / top).symlink_to(Path(str(one.locate_file(top))))
    assert not (site / "pytest").exists()
    return place


def test_the_sdist_has_the_workspace_and_nothing_else(sdist):
    found = {str(path.relative_to(sdist)) for path in sdist.rglob("*") if path.is_file()}
    wanted = {*tracked("ros_ws/src")} | {"LICENSE", "README.md", "CHANGELOG.md", "pyproject.toml", ".gitignore"}
    assert found - {"PKG-INFO"} == wanted


def test_the_wheel_has_the_packages_with_their_data_and_the_messages_and_nothing_else(wheel):
    found = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    packages = {name: f"ros_ws/src/{name}/" for name in PYTHON_PACKAGES}
    wanted = {name.removeprefix(top) for package, top in packages.items() for name in tracked(f"{top}{package}")}
    messages = {name for name in tracked("ros_ws/src/skd_msgs") if name.endswith((".msg", "package.xml"))}
    assert found == wanted | {name.replace("ros_ws/src", "skd_sim/ros_environment") for name in messages}


def test_it_assesses_and_reports(environment, tmp_path):
    skd = environment / "bin" / "skd"
    places = "; ".join(f"import {name}; print({name}.__file__)" for name in PYTHON_PACKAGES)
    for place in run(environment / "bin" / "python", "-c", places, folder=tmp_path).split():
        assert Path(place).is_relative_to(environment)
    assert "basic, C = 1" in run(skd, "assess", *SMALL, "--out", "out", folder=tmp_path)
    figures = json.loads((tmp_path / "out" / "assessment.json").read_text(encoding="utf-8"))
    assert figures["deviation"] is not None
    assert figures["provenance"]["git"] is None
    run(skd, "report", "out", "--out", "report.html", folder=tmp_path)
    assert "vega" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_advice_names_what_an_index_has(environment, tmp_path):
    """Packages that exist, with the ranges of the extras; a checkout is not there."""
    said = run(environment / "bin" / "skd", "doctor", "--no-round-trip", "--json", folder=tmp_path)
    advice = {one["name"]: one["remedy"] for one in json.loads(said)["findings"] if one["state"] == "absent"}
    (cluster,) = [text for text in metadata.requires("skd") or () if 'extra == "dask"' in text.replace("'", '"')]
    words = advice["dask"].split(" -m pip install ")
    assert words[0] == str(environment / "bin" / "python")
    assert Requirement(words[1].strip("'")).name == Requirement(cluster).name
    assert not [text for text in advice.values() if "skd[" in text or "scripts/" in text]
