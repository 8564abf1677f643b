"""Folders of .msg files: what is found in them, in which order it is built, and what is wrong with them in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from skd_sim.errors import UsageError
from skd_sim.ros_environment import installation
from skd_sim.ros_environment.installation import MessagePackage, ensure_messages
from skd_sim.ros_environment.variables import is_sourced

pytestmark = pytest.mark.skipif(is_sourced(), reason="a ROS 2 is sourced, so nothing is built")


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


def test_a_package_is_built_after_those_that_it_uses_and_only_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, built: list[str]
) -> None:
    package(tmp_path / "deep" / "down" / "top", "top_msgs", "std_msgs/Header header\nleft_msgs/Command left\n")
    package(tmp_path / "left", "left_msgs", "# low_msgs/Other is no field\nlow_msgs/Command[3] low  # this is\n")
    package(tmp_path / "low", "low_msgs", "float64 A=1.0\nfloat64 value\nlow_msgs/Other of_its_own\n")
    package(tmp_path / "other", "other_msgs", "float64 value\n")
    monkeypatch.setattr("sys.prefix", str(tmp_path / "prefix"))
    (tmp_path / "prefix").mkdir()
    first = ensure_messages([str(tmp_path)], "top_msgs")
    assert built == ["low_msgs", "left_msgs", "top_msgs"]
    assert ensure_messages([str(tmp_path)], "top_msgs") == first
    assert len(built) == 3
    (tmp_path / "other" / "msg" / "Command.msg").write_text("float32 value\n")
    assert ensure_messages([str(tmp_path)], "top_msgs") == first  # it uses nothing of that
    (tmp_path / "low" / "msg" / "Command.msg").write_text("float32 value\n")
    assert ensure_messages([str(tmp_path)], "top_msgs") != first
    assert len(built) == 6


def test_what_is_wrong_with_a_folder_is_one_line(tmp_path: Path, built: list[str]) -> None:
    (tmp_path / "empty").mkdir()
    package(tmp_path / "alone", "alone_msgs", "somebodys_msgs/Other other\n")
    package(tmp_path / "ring" / "one", "one_msgs", "two_msgs/Command command\n")
    package(tmp_path / "ring" / "two", "two_msgs", "one_msgs/Command command\n")
    package(tmp_path / "broken", "broken_msgs", "float64 value\n")
    (tmp_path / "broken" / "package.xml").write_text("<package><name>broken_msgs</name>")
    for folder, name, said in (
        ("no", "alone_msgs", "no such folder"),
        ("empty", "alone_msgs", r"holds no package of messages \(package.xml"),
        ("alone", "vendor_msgs", "there is no package vendor_msgs; there is alone_msgs"),
        ("alone", "alone_msgs", "alone_msgs uses messages of somebodys_msgs, which is neither installed nor in"),
        ("ring", "one_msgs", "use each other in a circle: one_msgs, two_msgs"),
        ("broken", "broken_msgs", "broken/package.xml: no XML"),
    ):
        with pytest.raises(UsageError, match=said) as caught:
            ensure_messages([str(tmp_path / folder)], name)
        assert "\n" not in str(caught.value)
    assert built == []
