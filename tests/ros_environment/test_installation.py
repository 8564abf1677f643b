"""ROS 2 and a user's messages: when they are added, in which order they are built, and what is said where not."""

import hashlib
import os
import re
import shutil
import sys
import threading
import time
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from skd_sim.errors import UsageError
from skd_sim.ros_environment import installation
from skd_sim.ros_environment.installation import MessagePackage, ensure_ros, is_ready, message_package

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(installation.__file__).parent


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An environment to which nothing has been added; nothing is installed by these tests."""
    for name in ("ROS_DISTRO", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(installation, "_add", lambda: pytest.fail("it began to install"))
    return tmp_path


def test_a_python_of_the_system_is_left_alone(bare, monkeypatch):
    monkeypatch.setattr(sys, "base_prefix", str(bare))
    with pytest.raises(UsageError, match=r"a virtual environment, and .* is none"):
        ensure_ros()


def test_with_ros_sourced_nothing_is_installed(bare, monkeypatch):
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setattr(installation.importlib.util, "find_spec", lambda name: None if name == "skd_msgs" else name)
    with pytest.raises(UsageError, match=r"jazzy is sourced, but skd_msgs is not found; .*colcon build"):
        ensure_ros()
    monkeypatch.setattr(installation.importlib.util, "find_spec", lambda name: name)
    ensure_ros()


def added(times: list[float]) -> None:
    """Stands for the installation: takes a while, and leaves its stamp."""
    times.append(time.monotonic())
    time.sleep(0.3)
    installation._stamp().write_text(installation.environment_digest(), encoding="utf-8")


def test_of_two_at_once_one_installs_and_the_other_waits(bare, monkeypatch, capsys):
    times: list[float] = []
    monkeypatch.setattr(installation, "_add", lambda: added(times))
    threads = [threading.Thread(target=ensure_ros) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(times) == 1
    assert is_ready()
    assert "another process is adding ROS 2; waiting for it" in capsys.readouterr().err


def test_other_messages_are_built_anew(bare, monkeypatch):
    source = bare / "skd_msgs"
    shutil.copytree(message_package().folder, source)
    monkeypatch.setattr(installation, "built_packages", lambda: [MessagePackage(source)])
    times: list[float] = []
    monkeypatch.setattr(installation, "_add", lambda: added(times))
    for _ in range(2):
        ensure_ros()
    assert len(times) == 1
    with (source / "msg" / "EpisodeResult.msg").open("a") as file:
        file.write("float64 another\n")
    assert not is_ready()
    ensure_ros()
    assert len(times) == 2


def test_a_wheel_with_another_hash_is_refused(tmp_path, monkeypatch):
    name = "skd_stands_for_a_wheel"
    wheel = tmp_path / f"{name}-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr(f"{name}.py", "")
        about = f"{name}-1.0.dist-info"
        archive.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        archive.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{about}/RECORD", "")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    right = hashlib.sha256(wheel.read_bytes()).hexdigest()
    wrong = right[:-1] + ("0" if right[-1] != "0" else "1")
    list_ = tmp_path / "list.txt"
    list_.write_text(f"{name}==1.0 --hash=sha256:{wrong}\n")
    with pytest.raises(UsageError, match="DO NOT MATCH THE HASHES"):
        installation.install(list_, tmp_path / "log")
    list_.write_text(f"{name}==1.0\n")
    with pytest.raises(UsageError, match=r"(?i)hash"):
        installation.install(list_, tmp_path / "log")


def test_what_a_failed_command_said_is_in_the_one_line_and_in_the_log(tmp_path):
    log = tmp_path / "log"
    program = "print('fine'); print('fatal error: no such header'); print('stopped'); raise SystemExit(3)"
    with pytest.raises(UsageError, match=rf"added: fatal error: no such header; the whole log is {log}"):
        installation.run([sys.executable, "-c", program], log)
    assert log.read_text().splitlines()[1:] == ["fine", "fatal error: no such header", "stopped"]
    with pytest.raises(UsageError, match="no-such-command: No such file"):
        installation.run(["no-such-command"], log)


def locked(name: str) -> dict[str, list[str]]:
    """Packages with their versions, and hashes, of one of the lists."""
    lines = [line for line in (HERE / f"{name}.txt").read_text().splitlines() if not line.startswith("#")]
    return {line.split()[0]: re.findall(r"--hash=sha256:([0-9a-f]{64})", line) for line in lines}


def test_everything_is_pinned_with_hashes():
    for name in ("wheels", "sources", "compiler"):
        assert locked(name)
        for package, hashes in locked(name).items():
            assert re.fullmatch(r"[a-z0-9-]+==[0-9.]+", package)
            assert len(hashes) in (1, 3), package  # one for all Pythons, or one for each


def test_the_lists_are_those_of_the_extras():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for extra, lists in (("ros", ("wheels", "sources")), ("ros-compiler", ("compiler",))):
        there = {package for name in lists for package in locked(name)}
        for text in extras[extra]:
            requirement = Requirement(text)
            assert f"{requirement.name.replace('_', '-')}{requirement.specifier}" in there


def package(folder: Path, name: str, text: str) -> None:
    (folder / "msg").mkdir(parents=True)
    (folder / "msg" / "Command.msg").write_text(text)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>\n")


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was built, in this order; nothing is."""
    order: list[str] = []

    def build(wanted: list[MessagePackage], place: Path) -> None:
        order.extend(one.name for one in wanted)
        place.mkdir()

    monkeypatch.setattr(installation, "_build", build)
    return order
