"""Builds messages that have no wheel, SKD's own among them, into this environment: the wheels made it a ROS prefix."""

from __future__ import annotations

import os
import re
import shutil
import sys
import sysconfig
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import read_text
from skd_sim.ros_environment.step import Step
from skd_sim.ros_environment.variables import node_variables

_HERE = Path(__file__).resolve().parent
_BUILD_PYTHON = r"/opt/python/[^;\"]*/include/python3[^;\"]*"
_OF_PACKAGE = re.compile(r"^[ \t]*([a-z][a-z0-9_]*)/[A-Z]", re.MULTILINE)  # a field of a type of that package
_BUILD_NUMPY = r"/opt/python/[^;\"]*/numpy/[^;\"]*include"


@dataclass(frozen=True)
class MessagePackage:
    """The sources of a package of messages.

    Attributes:
        folder: folder that holds its package.xml and msg/.
    """

    folder: Path

    @property
    def name(self) -> str:
        """Name of the package, as ROS 2 has it."""
        return str(ElementTree.parse(self.folder / "package.xml").findtext("name", self.folder.name)).strip()

    @property
    def files(self) -> list[Path]:
        """What decides how its messages look, sorted."""
        return [self.folder / "package.xml", *sorted(self.folder.glob("msg/*.msg"))]

    def dependencies(self) -> list[str]:
        """Return the packages whose messages these use, by their definitions: package.xml has many words for it."""
        texts = (read_text(file) for file in self.files[1:])
        return sorted({name for text in texts for name in _OF_PACKAGE.findall(text)} - {self.name})


def message_package() -> MessagePackage:
    """Return skd_msgs: of the checkout, or as it comes with an installed SKD.

    Raises:
        UsageError: it is in neither place.
    """
    for place in (*_HERE.parents, _HERE):
        if (place / "skd_msgs" / "msg" / "Episode.msg").is_file():
            return MessagePackage(place / "skd_msgs")
    raise UsageError("the definitions of skd_msgs are not installed: install SKD from its checkout or wheel")


def built_packages() -> list[MessagePackage]:
    """Return all packages that are built where no ROS 2 is sourced: skd_msgs, and what else has no wheel.

    Raises:
        UsageError: as `message_package`.
    """
    return [message_package(), *packages_without_wheel()]


def packages_without_wheel() -> list[MessagePackage]:
    """Return the messages of others that have no wheel and that SKD uses, with the type hashes of the originals.

    Where SKD is installed in a workspace of ROS 2 they are in its prefixes, and not here.
    """
    folder = _HERE / "packages"
    return [MessagePackage(place) for place in sorted(folder.iterdir())] if folder.is_dir() else []


@dataclass(frozen=True)
class Compiler:
    """Commands of a C and a C++ compiler, and CMake's variables for the tools beside them."""

    c: str
    cpp: str
    tools: tuple[str, ...] = ()


def find_compiler() -> Compiler | None:
    """Return the machine's compiler ($CC and $CXX, or what is on the PATH); none where there is none.

    Raises:
        UsageError: Python's headers are missing, without which no compiler helps.
    """
    headers = Path(sysconfig.get_path("include"))
    if not (headers / "Python.h").is_file():
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise UsageError(
            f"the messages are compiled against Python's headers, and {headers}/Python.h is missing: "
            f"sudo apt install python{version}-dev, or set SKD_PYTHON to a Python that has them"
        )
    c = next(filter(shutil.which, filter(None, (os.environ.get("CC"), "cc", "gcc", "clang"))), None)
    cpp = next(filter(shutil.which, filter(None, (os.environ.get("CXX"), "c++", "g++", "clang++"))), None)
    return Compiler(c, cpp) if c and cpp else None


def _zig(folder: Path) -> Compiler:
    """Return the compiler that the wheel `ziglang` holds; CMake wants each tool as a program of its own."""
    programs = {}
    for name in ("cc", "c++", "ar", "ranlib"):
        program = folder / f"zig-{name}"
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ziglang {name} "$@"\n', encoding="utf-8")
        program.chmod(0o755)
        programs[name] = str(program)
    tools = (f"-DCMAKE_AR={programs['ar']}", f"-DCMAKE_RANLIB={programs['ranlib']}")
    return Compiler(programs["cc"], programs["c++"], tools)


def cmake_prefix(folder: Path) -> Path:
    """Make a ROS prefix for CMake in an empty folder: this environment, with the wheels' CMake files mended.

    Those name Python's and numpy's headers where the wheels were built. The wheels stay as they are.

    Args:
        folder: empty; what is made there holds links into this environment.
    """
    for part in ("bin", "include", "lib", "tools"):
        if Path(sys.prefix, part).exists():
            (folder / part).symlink_to(Path(sys.prefix, part))
    shutil.copytree(Path(sys.prefix, "share"), folder / "share", symlinks=True)
    import numpy as np  # slow to import, and needed only now

    headers = sysconfig.get_path("include")
    for file in folder.glob("share/*/cmake/*.cmake"):
        text = file.read_text(encoding="utf-8")
        if "/opt/python/" in text:
            text = re.sub(_BUILD_NUMPY, lambda _: np.get_include(), text)
            file.write_text(re.sub(_BUILD_PYTHON, lambda _: headers, text), encoding="utf-8")
    return folder


def build_messages(packages: Sequence[MessagePackage], compiler: Compiler | None, target: Path, step: Step) -> None:
    """Build packages of messages with what rclpy needs of them, and install them.

    Args:
        packages: packages to build; none may depend on another one of them, but each may depend on what is in `target`
            already.
        compiler: the compiler; None: that of the wheel `ziglang`.
        target: prefix to install into.
        step: runs the commands and shows how long they take.

    Raises:
        UsageError: they cannot be built.
    """
    with tempfile.TemporaryDirectory(prefix="skd-messages-") as scratch:
        source, build, prefix, tools = (Path(scratch, name) for name in ("source", "build", "prefix", "tools"))
        for folder in (source, prefix, tools):
            folder.mkdir()
        shutil.copy(_HERE / "CMakeLists.txt", source)
        for package in packages:
            shutil.copytree(package.folder, source / package.name)
            shutil.copy(_HERE / "package.cmake", source / package.name / "CMakeLists.txt")
        chosen = compiler or _zig(tools)
        cmake_prefix(prefix)
        environment = node_variables(os.environ)
        environment["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), environment.get("PATH", os.defpath)])
        environment["AMENT_PREFIX_PATH"] = str(prefix)
        definitions = {
            "CMAKE_BUILD_TYPE": "Release",
            "CMAKE_INSTALL_PREFIX": str(target),
            "CMAKE_PREFIX_PATH": str(prefix) if target == Path(sys.prefix) else f"{prefix};{target}",
            "CMAKE_C_COMPILER": chosen.c,
            "CMAKE_CXX_COMPILER": chosen.cpp,
            "Python3_EXECUTABLE": sys.executable,
            "BUILD_TESTING": "OFF",
            "SKD_PACKAGES": ";".join(package.name for package in packages),
            "SKD_DEPENDENCIES": ";".join(sorted({name for package in packages for name in package.dependencies()})),
        }
        for package in packages:
            definitions[f"SKD_DEPENDENCIES_OF_{package.name}"] = ";".join(package.dependencies())
        options = [f"-D{name}={value}" for name, value in definitions.items()]
        step.run(["cmake", "-G", "Ninja", "-S", str(source), "-B", str(build), *options, *chosen.tools], environment)
        step.run(["cmake", "--build", str(build)], environment)
        for package in packages:
            remove_messages(package.name, target)
        step.run(["cmake", "--install", str(build)], environment)


def remove_messages(name: str, target: Path) -> None:
    """Take away what an earlier build of a package has installed."""
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(target)}))
    for folder in (packages / name, target / "share" / name, target / "include" / name):
        shutil.rmtree(folder, ignore_errors=True)
    for library in (target / "lib").glob(f"lib{name}__*"):
        library.unlink()
