"""Message packages of a user that no sourced workspace has: built once, into a folder of this environment.

The folder is named for all that decides what is built, so it never has to be looked after: other definitions, another
folder. The environment itself stays as it is.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import sys
import sysconfig
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import read_bytes
from skd_sim.ros_environment.installation import environment_digest
from skd_sim.ros_environment.lock import locked
from skd_sim.ros_environment.messages import MessagePackage, build_messages, find_compiler
from skd_sim.ros_environment.step import Step
from skd_sim.ros_environment.variables import is_sourced

PREFIX = "SKD_MESSAGE_PREFIX"
"""Variable that says where the packages of this run are."""


def ensure_messages(folders: Sequence[str], package: str) -> Path | None:
    """Make sure that a package of messages can be imported: build it from these folders if it is not installed.

    Args:
        folders: folders in which to look for packages, at any depth.
        package: name of the package whose messages are needed; those that it uses come with it.

    Returns:
        The prefix that holds them; none where nothing had to be built.

    Raises:
        UsageError: it is not there, or cannot be built.
    """
    found = dict(one for folder in folders for one in _packages_in(Path(folder).expanduser()))
    if is_installed(package):
        return None
    if package not in found:
        raise UsageError(
            f"--message-folder {', '.join(folders)}: there is no package {package}; there "
            f"{'is' if len(found) == 1 else 'are'} {', '.join(sorted(found))}"
        )
    if is_sourced():
        raise UsageError(
            f"{package} is not in the ROS 2 that is sourced: build it in your workspace and source that "
            f"(colcon build --packages-up-to {package}); --message-folder is for where none is"
        )
    rounds = _rounds(package, found)
    wanted = [one for together in rounds for one in together]
    place = Path(sys.prefix, "messages", _digest(wanted))
    if not place.is_dir():
        place.parent.mkdir(exist_ok=True)
        with locked(place.parent / ".lock", "building messages"):
            if not place.is_dir():
                _build(rounds, place)
    return place


def message_variables(environment: Mapping[str, str], prefix: Path | None) -> dict[str, str]:
    """Return the environment in which a Python finds the messages in a prefix too, if there is one."""
    if prefix is None:
        return dict(environment)
    changed = {**environment, PREFIX: str(prefix)}
    for name, folder in (("PYTHONPATH", _modules(prefix)), ("LD_LIBRARY_PATH", prefix / "lib")):
        parts = [part for part in environment.get(name, "").split(os.pathsep) if part]
        if str(folder) not in parts:  # else they stay as they are, in whatever order: this program may have begun anew
            changed[name] = os.pathsep.join([str(folder), *parts])
    return changed


def is_installed(package: str) -> bool:
    """Return whether a package of messages can be imported as the environment is, without what this run adds."""
    added = os.environ.get(PREFIX, "")
    try:
        spec = importlib.util.find_spec(package)
    except ValueError:  # a module of that name that is half made
        return True
    return spec is not None and not (added and str(spec.origin).startswith(added))


def _modules(prefix: Path) -> Path:
    return Path(sysconfig.get_path("purelib", vars={"base": str(prefix)}))


def _packages_in(folder: Path) -> Iterator[tuple[str, MessagePackage]]:
    """Yield the packages of messages in a folder, each with its name.

    Raises:
        UsageError: there are none.
    """
    files = sorted(folder.rglob("package.xml")) if folder.is_dir() else []
    some = False
    for file in files:
        if any(file.parent.glob("msg/*.msg")):
            try:
                name = MessagePackage(file.parent).name
            except ElementTree.ParseError as error:
                raise UsageError(f"{file}: no XML ({error})") from error
            yield name, MessagePackage(file.parent)
            some = True
    if not some:
        why = "holds no package of messages (package.xml, and beside it msg/*.msg)"
        raise UsageError(f"--message-folder {folder}: {why if folder.is_dir() else 'no such folder'}")


def _rounds(package: str, found: Mapping[str, MessagePackage]) -> list[list[MessagePackage]]:
    """Return which packages have to be built for a package, in rounds: each round depends only on those before it.

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
    rounds = []
    while uses:
        ready = sorted(name for name, others in uses.items() if not others & set(uses))
        if not ready:
            raise UsageError(f"these packages of messages use each other in a circle: {', '.join(sorted(uses))}")
        rounds.append([found[name] for name in ready])
        for name in ready:
            del uses[name]
    return rounds


def _digest(packages: Sequence[MessagePackage]) -> str:
    """Return what names the result: the definitions, the ROS 2 that they are built with, and the Python."""
    digest = hashlib.sha256(f"{environment_digest()} {sys.version}".encode())
    for package in packages:
        for file in package.files:
            digest.update(f"\0{package.name}/{file.name}\0".encode())
            digest.update(read_bytes(file))
    return digest.hexdigest()[:16]


def _build(rounds: Sequence[Sequence[MessagePackage]], place: Path) -> None:
    names = ", ".join(package.name for together in rounds for package in together)
    print(f"skd: building messages of {names} in {place} (once)", file=sys.stderr)
    compiler, log = find_compiler(), place.parent / "build.log"
    log.unlink(missing_ok=True)
    target = Path(tempfile.mkdtemp(prefix=".building-", dir=place.parent))
    try:
        for together in rounds:
            with (
                tempfile.TemporaryDirectory(prefix="skd-messages-") as copies,
                Step("messages", log, failure=f"{names} cannot be built") as step,
            ):
                build_messages([_copy(package, Path(copies)) for package in together], compiler, target, step)
        target.rename(place)
    finally:
        shutil.rmtree(target, ignore_errors=True)


def _copy(package: MessagePackage, place: Path) -> MessagePackage:
    """Return a copy of a package with its messages alone, and with a package.xml in which nothing is missing.

    What else is in it, a build of its own, services, rules for a linter, is nothing that a command needs.
    """
    folder = place / package.name
    (folder / "msg").mkdir(parents=True)
    for file in package.folder.glob("msg/*.msg"):
        shutil.copy(file, folder / "msg")
    uses = "".join(f"<depend>{name}</depend>" for name in package.dependencies())
    (folder / "package.xml").write_text(
        f'<package format="3"><name>{package.name}</name><version>0.0.0</version><description>Messages.</description>'
        f'<maintainer email="nobody@example.org">nobody</maintainer><license>as the original</license>{uses}'
        "<member_of_group>rosidl_interface_packages</member_of_group></package>\n",
        encoding="utf-8",
    )
    return MessagePackage(folder)
