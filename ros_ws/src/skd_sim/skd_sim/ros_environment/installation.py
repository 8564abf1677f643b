"""Adds ROS 2 Jazzy to this environment, once: its wheels, pinned and with hashes, and messages that have none.

Messages are compiled: SKD's own, those of others that have no wheel, and, into folders of their own, those of a user
that no sourced workspace has. The wheels made this environment a ROS prefix, with which CMake builds them.
"""

from __future__ import annotations

import fcntl
import functools
import graphlib
import hashlib
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_text

_HERE = Path(__file__).resolve().parent
_WHEELS, _SOURCES, _COMPILER = (_HERE / f"{name}.txt" for name in ("wheels", "sources", "compiler"))
_ELSEWHERE = (
    "install ROS 2 Jazzy yourself (Ubuntu 24.04: apt install ros-jazzy-ros-base), source it, then "
    "cd ros_ws && colcon build && . install/setup.bash"
)
_ERROR = re.compile(r"\berror\b", re.IGNORECASE)
_OF_PACKAGE = re.compile(r"^[ \t]*([a-z][a-z0-9_]*)/[A-Z]", re.MULTILINE)  # a field of a type of that package
_BUILD_PYTHON = r"/opt/python/[^;\"]*/include/python3[^;\"]*"
_BUILD_NUMPY = r"/opt/python/[^;\"]*/numpy/[^;\"]*include"


# --- the variables by which a process loads ROS 2's libraries from the wheels, and that no other program may inherit
# The wheels bring a `.pth` file that starts every Python of the environment a second time, with LD_LIBRARY_PATH set,
# unless a guard says that this was done. A program of ours sets both itself, and only where it needs them.

GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Variable by which the wheels know that LD_LIBRARY_PATH is set."""

PREFIX = "SKD_MESSAGE_PREFIX"
"""Variable that says where a user's packages of messages are for this run."""
_PATH = "LD_LIBRARY_PATH"


def is_sourced(environment: Mapping[str, str] | None = None) -> bool:
    """Return whether a ROS 2 from elsewhere is in force, as after `. /opt/ros/jazzy/setup.bash`."""
    chosen = os.environ if environment is None else environment
    return bool(chosen.get("ROS_DISTRO") or chosen.get("AMENT_PREFIX_PATH"))


def library_folders() -> list[str]:
    """Return the folders of this environment in which the wheels' libraries lie; none where there are no wheels."""
    bundled = sorted(str(folder) for folder in Path(sysconfig.get_path("purelib")).glob("ros_*.libs"))
    return [str(Path(sys.prefix, "lib")), *bundled] if bundled else []


def node_variables(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment in which a Python of ours can import rclpy at once."""
    folders = [] if is_sourced(environment) else library_folders()
    if not folders:
        return dict(environment)
    others = [part for part in environment.get(_PATH, "").split(os.pathsep) if part and part not in folders]
    return {**environment, _PATH: os.pathsep.join([*folders, *others]), GUARD: "1"}


def foreign_variables(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment without what `node_variables` adds: for programs that are not ours."""
    folders = library_folders()
    clean = {name: value for name, value in environment.items() if name not in (GUARD, _PATH)}
    others = [part for part in environment.get(_PATH, "").split(os.pathsep) if part and part not in folders]
    return {**clean, _PATH: os.pathsep.join(others)} if others else clean


def message_variables(environment: Mapping[str, str], prefix: Path | None) -> dict[str, str]:
    """Return the environment in which a Python finds the messages in a prefix too, if there is one."""
    if prefix is None:
        return dict(environment)
    changed = {**environment, PREFIX: str(prefix)}
    modules = sysconfig.get_path("purelib", vars={"base": str(prefix)})
    for name, folder in (("PYTHONPATH", modules), ("LD_LIBRARY_PATH", str(prefix / "lib"))):
        parts = [part for part in environment.get(name, "").split(os.pathsep) if part]
        if folder not in parts:  # else they stay as they are, in whatever order: this program may have begun anew
            changed[name] = os.pathsep.join([folder, *parts])
    return changed


def enter_ros() -> None:
    """Begin this process anew where it could not load ROS 2's libraries: the loader reads its variables only then."""
    wanted = node_variables(os.environ)
    if wanted.get(_PATH) != os.environ.get(_PATH):
        sys.stdout.flush()
        sys.stderr.flush()
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], wanted)


# --- whether there is something to add


def ensure_ros() -> None:
    """See that rclpy and the messages can be imported by processes of this environment; add them where they cannot.

    Raises:
        UsageError: they cannot be had here; the message names the remedy.
    """
    if is_sourced():
        for name in ("rclpy", "skd_msgs"):
            if importlib.util.find_spec(name) is None:
                raise UsageError(
                    f"ROS 2 {os.environ.get('ROS_DISTRO', '')} is sourced, but {name} is not found; build and source "
                    "the workspace: cd ros_ws && colcon build && . install/setup.bash"
                )
    elif not is_ready():
        _check_platform()
        with locked(Path(sys.prefix, ".skd-ros.lock"), "adding ROS 2"):
            if not is_ready():
                _add()


def is_ready() -> bool:
    """Return whether there is nothing to add: wheels and messages are as this version of SKD wants them."""
    if is_sourced():
        return True
    try:
        return _stamp().read_text(encoding="utf-8") == environment_digest()
    except FileNotFoundError:
        return False


def _stamp() -> Path:
    return Path(sys.prefix, ".skd-ros")


def environment_digest() -> str:
    """Return a digest of all that decides what is installed."""
    digest = hashlib.sha256()
    recipes = (_WHEELS, _SOURCES, _HERE / "CMakeLists.txt", _HERE / "package.cmake")
    for file in (*recipes, *(file for package in built_packages() for file in package.files)):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _check_platform() -> None:
    system = f"{platform.system()} on {platform.machine()}"
    if system != "Linux on x86_64":
        raise UsageError(
            f"the node graph needs ROS 2 Jazzy, whose wheels are for Linux on x86_64, not {system}: {_ELSEWHERE}"
        )
    if sys.prefix == sys.base_prefix:
        raise UsageError(
            f"the node graph needs ROS 2 Jazzy, which is added to a virtual environment, and {sys.prefix} is none: "
            f"run SKD in one, or {_ELSEWHERE}"
        )


@contextmanager
def locked(file: Path, what: str) -> Iterator[None]:
    """Hold the lock that a file is, and say what another process is doing where that has to be waited for."""
    with file.open("w") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"skd: another process is {what}; waiting for it", file=sys.stderr)
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _add() -> None:
    compiler, packages, digest = find_compiler(), built_packages(), environment_digest()
    how_long = "a minute" if compiler else "three minutes: no C++ compiler is installed, so one is fetched as well"
    print(f"skd: adding ROS 2 Jazzy to {sys.prefix} (once, about {how_long})", file=sys.stderr)
    log = Path(sys.prefix, "ros.log")
    log.unlink(missing_ok=True)
    _stamp().unlink(missing_ok=True)
    install(_WHEELS, log, "--only-binary", ":all:")
    # After the wheels, with which it is built: nothing that is not listed may come in, not even to build something.
    install(_SOURCES, log, "--no-build-isolation")
    if compiler is None:
        install(_COMPILER, log, "--only-binary", ":all:")
    build_messages(packages, compiler, Path(sys.prefix), log)
    temporary = _stamp().with_suffix(f".{os.getpid()}")
    temporary.write_text(digest, encoding="utf-8")
    temporary.replace(_stamp())


def install(requirements: Path, log: Path, *options: str) -> None:
    """Install exactly what a file lists: each archive's hash is checked, and nothing else is drawn in.

    Raises:
        UsageError: it cannot be installed.
    """
    pip = [sys.executable, "-m", "pip"]
    if importlib.util.find_spec("pip") is None:
        pip = [os.path.realpath(sys.executable), "-m", "pip", "--python", sys.executable]
    strict = ["--no-deps", "--require-hashes", "--progress-bar", "off", "--disable-pip-version-check"]
    run([*pip, "install", *strict, *options, "-r", str(requirements)], log)


def run(command: Sequence[str], log: Path, environment: Mapping[str, str] | None = None) -> None:
    """Run a command to its end; what it prints goes to a log.

    Raises:
        UsageError: it cannot be started, or fails; the line has the first error that it printed.
    """
    with log.open("a", encoding="utf-8") as file:
        file.write(f"$ {' '.join(command)}\n")
        file.flush()
        begin = file.tell()
        try:
            code = subprocess.run(
                command, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT, env=environment, check=False
            ).returncode
        except OSError as error:
            raise UsageError(f"ROS 2 could not be added: {command[0]}: {error.strerror}") from error
    if code:
        printed = log.read_bytes()[begin:].decode(errors="replace").splitlines()
        lines = [line.strip() for line in printed if line.strip()] or [f"exit code {code}"]
        said = next(filter(_ERROR.search, lines), lines[-1])[:200]
        raise UsageError(f"ROS 2 could not be added: {said}; the whole log is {log}")


# --- packages of messages


@dataclass(frozen=True)
class MessagePackage:
    """The sources of a package of messages.

    Attributes:
        folder: folder that holds its package.xml and msg/.
    """

    folder: Path

    @functools.cached_property
    def name(self) -> str:
        """Name of the package, as ROS 2 has it.

        Raises:
            UsageError: its package.xml is none.
        """
        file = self.folder / "package.xml"
        try:
            return str(ElementTree.parse(file).findtext("name", self.folder.name)).strip()
        except ElementTree.ParseError as error:
            raise UsageError(f"{file}: no XML ({error})") from error

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


def packages_without_wheel() -> list[MessagePackage]:
    """Return the third-party messages that SKD uses and that have no wheel, with the type hashes of the originals.

    Where SKD is installed in a workspace of ROS 2 they are in its prefixes, and not here.
    """
    folder = _HERE / "packages"
    return [MessagePackage(place) for place in sorted(folder.iterdir())] if folder.is_dir() else []


def built_packages() -> list[MessagePackage]:
    """Return all packages that are built where no ROS 2 is sourced: skd_msgs, and what else has no wheel.

    Raises:
        UsageError: as `message_package`.
    """
    return [message_package(), *packages_without_wheel()]


def ensure_messages(folders: Sequence[str], package: str) -> Path | None:
    """Make sure that a package of messages can be imported: build it from these folders if it is not installed.

    The folder that holds the result is named for all that decides what is built: other definitions, another folder.

    Args:
        folders: folders in which to look for packages, at any depth.
        package: name of the package whose messages are needed; those that it uses come with it.

    Returns:
        The prefix that holds them; none where nothing had to be built.

    Raises:
        UsageError: it is not there, or cannot be built.
    """
    found = {one.name: one for folder in folders for one in _packages_in(Path(folder).expanduser())}
    if is_installed(package):
        return None
    if package not in found:
        raise UsageError(
            f"message_folder {', '.join(folders)}: there is no package {package}; there "
            f"{'is' if len(found) == 1 else 'are'} {', '.join(sorted(found))}"
        )
    if is_sourced():
        raise UsageError(
            f"{package} is not in the ROS 2 that is sourced: build it in your workspace and source that "
            f"(colcon build --packages-up-to {package}); message_folder is for where none is"
        )
    packages = _order(package, found)
    digest = hashlib.sha256(f"{environment_digest()} {sys.version}".encode())
    for one in packages:
        for file in one.files:
            digest.update(f"\0{one.name}/{file.name}\0{read_text(file)}".encode())
    place = Path(sys.prefix, "messages", digest.hexdigest()[:16])
    if not place.is_dir():
        place.parent.mkdir(exist_ok=True)
        with locked(place.parent / ".lock", "building messages"):
            if not place.is_dir():
                _build(packages, place)
    return place


def is_installed(package: str) -> bool:
    """Return whether a package of messages can be imported as the environment is, without what this run adds."""
    added = os.environ.get(PREFIX, "")
    try:
        spec = importlib.util.find_spec(package)
    except ValueError:  # a module of that name that is half made
        return True
    return spec is not None and not (added and str(spec.origin).startswith(added))


def _packages_in(folder: Path) -> list[MessagePackage]:
    files = sorted(folder.rglob("package.xml")) if folder.is_dir() else []
    found = [MessagePackage(file.parent) for file in files if any(file.parent.glob("msg/*.msg"))]
    if not found:
        why = "holds no package of messages (package.xml, and beside it msg/*.msg)"
        raise UsageError(f"message_folder {folder}: {why if folder.is_dir() else 'no such folder'}")
    return found


def _order(package: str, found: Mapping[str, MessagePackage]) -> list[MessagePackage]:
    """Return what has to be built for a package, each after those that it uses.

    Raises:
        UsageError: a package that they use is nowhere, or they use each other in a circle.
    """
    uses: dict[str, set[str]] = {}
    ahead = [(package, "")]
    while ahead:
        name, by = ahead.pop()
        if name in uses or is_installed(name):
            continue
        if name not in found:
            raise UsageError(f"{by} uses messages of {name}, which is neither installed nor in a --message-folder")
        uses[name] = set(found[name].dependencies())
        ahead += [(other, name) for other in uses[name]]
    try:
        return [found[name] for name in graphlib.TopologicalSorter(uses).static_order() if name in uses]
    except graphlib.CycleError as error:
        circle = ", ".join(sorted(set(error.args[1])))
        raise UsageError(f"packages of messages use each other in a circle: {circle}") from error


# --- building them


def _build(packages: Sequence[MessagePackage], place: Path) -> None:
    names = ", ".join(package.name for package in packages)
    print(f"skd: building messages of {names} in {place} (once)", file=sys.stderr)
    compiler, log = find_compiler(), place.parent / "build.log"
    log.unlink(missing_ok=True)
    target = Path(tempfile.mkdtemp(prefix=".building-", dir=place.parent))
    try:
        for package in packages:
            build_messages([package], compiler, target, log)
        target.rename(place)
    finally:
        shutil.rmtree(target, ignore_errors=True)


def _copy(package: MessagePackage, folder: Path) -> None:
    """Copy a package into a new folder: its messages alone, and a package.xml in which nothing is missing.

    What else is in it, a build of its own, services, rules for a linter, is nothing that a command needs.
    """
    (folder / "msg").mkdir(parents=True)
    shutil.copy(_HERE / "package.cmake", folder / "CMakeLists.txt")
    for file in package.files[1:]:
        shutil.copy(file, folder / "msg")
    uses = "".join(f"<depend>{name}</depend>" for name in package.dependencies())
    (folder / "package.xml").write_text(
        f'<package format="3"><name>{package.name}</name><version>0.0.0</version><description>Messages.</description>'
        f'<maintainer email="nobody@example.org">nobody</maintainer><license>as the original</license>{uses}'
        "<member_of_group>rosidl_interface_packages</member_of_group></package>\n",
        encoding="utf-8",
    )


def find_compiler() -> list[str] | None:
    """Return CMake's options for the machine's compiler ($CC and $CXX, or what is on the PATH); none without one.

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
    return [f"-DCMAKE_C_COMPILER={c}", f"-DCMAKE_CXX_COMPILER={cpp}"] if c and cpp else None


def _zig(folder: Path) -> list[str]:
    """Return CMake's options for the compiler that the wheel `ziglang` holds: each tool is a program of its own."""
    options = []
    for name, variable in (("cc", "C_COMPILER"), ("c++", "CXX_COMPILER"), ("ar", "AR"), ("ranlib", "RANLIB")):
        program = folder / f"zig-{name}"
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ziglang {name} "$@"\n', encoding="utf-8")
        program.chmod(0o755)
        options.append(f"-DCMAKE_{variable}={program}")
    return options


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


def build_messages(packages: Sequence[MessagePackage], compiler: list[str] | None, target: Path, log: Path) -> None:
    """Build packages of messages with what rclpy needs of them, and install them.

    Args:
        packages: packages to build; none may depend on another one of them, but each may depend on what is in `target`
            already.
        compiler: CMake's options for it; None: that of the wheel `ziglang`.
        target: prefix to install into.
        log: file for what the tools print.

    Raises:
        UsageError: they cannot be built.
    """
    with tempfile.TemporaryDirectory(prefix="skd-messages-") as scratch:
        source, build, prefix, tools = (Path(scratch, name) for name in ("source", "build", "prefix", "tools"))
        for folder in (source, prefix, tools):
            folder.mkdir()
        shutil.copy(_HERE / "CMakeLists.txt", source)
        for package in packages:
            _copy(package, source / package.name)
        cmake_prefix(prefix)
        environment = node_variables(os.environ)
        environment["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), environment.get("PATH", os.defpath)])
        environment["AMENT_PREFIX_PATH"] = str(prefix)
        definitions = {
            "CMAKE_BUILD_TYPE": "Release",
            "CMAKE_INSTALL_PREFIX": str(target),
            "CMAKE_PREFIX_PATH": str(prefix) if target == Path(sys.prefix) else f"{prefix};{target}",
            "Python3_EXECUTABLE": sys.executable,
            "BUILD_TESTING": "OFF",
            "SKD_PACKAGES": ";".join(package.name for package in packages),
            "SKD_DEPENDENCIES": ";".join(sorted({name for package in packages for name in package.dependencies()})),
        }
        definitions |= {f"SKD_DEPENDENCIES_OF_{one.name}": ";".join(one.dependencies()) for one in packages}
        options = [*(f"-D{name}={value}" for name, value in definitions.items()), *(compiler or _zig(tools))]
        run(["cmake", "-G", "Ninja", "-S", str(source), "-B", str(build), *options], log, environment)
        run(["cmake", "--build", str(build)], log, environment)
        for package in packages:
            _remove_messages(package.name, target)
        run(["cmake", "--install", str(build)], log, environment)


def _remove_messages(name: str, target: Path) -> None:
    """Take away what an earlier build of a package has installed."""
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(target)}))
    for folder in (packages / name, target / "share" / name, target / "include" / name):
        shutil.rmtree(folder, ignore_errors=True)
    for library in (target / "lib").glob(f"lib{name}__*"):
        library.unlink()
