"""Things that are chosen by name: SKD's own stand in a table, those of installed packages are found by entry points.

Nothing is imported before it is asked for by its name, and installed packages are looked through only for a name that
is not SKD's own, or for a list of all. A package adds its own in its pyproject.toml:

    [project.entry-points."skd.controllers"]
    careful = "my_package.cars:Careful"
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import importlib.util
import os
import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from skd_sim.errors import UsageError
from skd_sim.inputs.files import from_here, near_or_all, nearest
from skd_sim.interruption import Interrupted

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

LONGEST_NAME = 16
"""Characters that a name may have: recordings keep a column of them."""
_NAME = re.compile(r"[A-Za-z_][\w-]*")
CHECKOUTS: dict[str, tuple[str, ...]] = {}
"""By a folder of checkouts: the folders in each of them from which its files import before all others."""


def load(target: str, what: str) -> Any:
    """Return the attribute that `package.module:attribute` names.

    Args:
        target: the module and the name in it, as `package.module:attribute` or `path/to/file.py:attribute`.
        what: what the name stands for, for the error line, such as "controller 'careful'".

    Raises:
        UsageError: it cannot be loaded.
    """
    module, _, attribute = target.rpartition(":")
    try:
        found: Any = _module_of_file(Path(module)) if module.endswith(".py") else importlib.import_module(module)
    except (Interrupted, UsageError):  # this process is to end, or what is wrong is said already
        raise
    except BaseException as error:  # a user's module may raise anything, and end the program with a clean exit code
        file = f"{module}.py"
        missing = isinstance(error, ModuleNotFoundError) and error.name == module and Path(file).is_file()
        near = f"; did you mean {file}:{attribute}?" if missing else place_of(error)
        raise UsageError(f"{what} cannot be loaded: {reason_of(error)}{near}") from None
    for name in attribute.split("."):
        if not hasattr(found, name):
            names = [one for one, value in vars(found).items() if isinstance(value, type) and one[:1] != "_"]
            near = near_or_all(name, names or ["none"], "its classes:")
            raise UsageError(f"{what}: {Path(module).name} has no {name}{near}")
        found = getattr(found, name)
    return found


def _module_of_file(path: Path) -> ModuleType:
    """Import a file by its path; one in a package as part of it. What lies beside it can be imported by it.

    Raises:
        UsageError: there is no such file.
    """
    path = path.expanduser().absolute()
    if not path.is_file():
        near = nearest(path.name, (one.name for one in path.parent.glob("*.py")))
        meant = f"; did you mean {from_here(str(path.parent / near))!r}?" if near else ""
        raise UsageError(f"{from_here(str(path))}: there is no such file{meant}")
    top = next(folder for folder in path.parents if not (folder / "__init__.py").is_file())
    if str(top) not in sys.path:
        sys.path.append(str(top))
        for checkouts, folders in CHECKOUTS.items():
            if path.is_relative_to(checkouts):
                checkout = Path(checkouts, path.relative_to(checkouts).parts[0])
                sys.path[:0] = [str(top), *(str(checkout / one) for one in folders)]
    if top != path.parent:
        return importlib.import_module(".".join(path.relative_to(top).with_suffix("").parts))
    name = f"{path.stem}_{hashlib.sha256(os.fsencode(path)).hexdigest()[:8]}"  # two files may have one name
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]


def reason_of(error: BaseException) -> str:
    """Return in one line why a user's code failed."""
    try:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    except BaseException:
        reason = type(error).__name__
    return reason + ("; is it installed, or on PYTHONPATH?" if isinstance(error, ModuleNotFoundError) else "")


def place_of(error: BaseException, folder: str = "") -> str:
    """Return file and line of the last step in a folder, or in any code of a user's, that led to an error, in brackets.

    Empty where there is none.
    """
    own = "<", f"{Path(__file__).parents[2]}{os.sep}", importlib.__path__[0]
    steps = [one for one in traceback.extract_tb(error.__traceback__) if not one.filename.startswith(own)]
    mine = [one for one in steps if folder and one.filename.startswith(folder)] or steps
    return f" ({from_here(mine[-1].filename)}, line {mine[-1].lineno})" if mine else ""


@functools.cache
def _installed(group: str) -> Mapping[str, tuple[EntryPoint, ...]]:
    """Return what installed packages have registered in a group, by name."""
    from importlib.metadata import entry_points  # takes longer than all that a command needs to say its version

    found: dict[str, tuple[EntryPoint, ...]] = {}
    for entry in entry_points(group=group):
        if entry not in found.get(entry.name, ()):
            found[entry.name] = (*found.get(entry.name, ()), entry)
    return found


def _exists(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # of a package that it is in
        return False


class Registry:
    """The things of one kind that can be chosen by name.

    Attributes:
        what: the kind of thing, in messages.
        group: group of the entry points of installed packages.
        own: SKD's own: name → `package.module:attribute`, in the order in which they are listed.
    """

    def __init__(self, what: str, group: str, own: Mapping[str, str]) -> None:
        """Register SKD's own."""
        self.what, self.group, self.own = what, group, dict(own)

    def names(self) -> tuple[str, ...]:
        """Return all names: SKD's own, then those of installed packages by the alphabet."""
        return (*self.own, *sorted(set(_installed(self.group)) - set(self.own)))

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def __contains__(self, name: object) -> bool:
        return name in self.own or name in _installed(self.group)

    def target(self, name: str) -> str:
        """Return where the thing with a name is, as `package.module:attribute`. SKD's own names cannot be taken.

        Raises:
            UsageError: nothing has this name, two packages claim it, or it is too long or no word.
        """
        if name in self.own:
            return self.own[name]
        entries = _installed(self.group).get(name, ())
        if not entries:
            raise UsageError(f"unknown {self.what} {name!r}{near_or_all(name, self.names(), 'known are')}")
        if len(entries) > 1:
            where = " and ".join(entry.value for entry in entries)
            raise UsageError(f"{self.what} {name!r} is registered more than once: {where}; remove one of the packages")
        if len(name) > LONGEST_NAME or not _NAME.fullmatch(name):
            raise UsageError(
                f"{self.what} {name!r} ({entries[0].value}) needs another name: a word of at most {LONGEST_NAME} "
                "letters, digits, _ and -"
            )
        return entries[0].value

    def registered(self) -> Iterator[str]:
        """Yield the names of installed packages' own, by the alphabet; none whose module was deleted."""
        for name in self.names()[len(self.own) :]:
            if _exists(self.target(name).partition(":")[0]):
                yield name

    def find(self, name: str) -> Any:
        """Import and return the thing with a name.

        Raises:
            UsageError: nothing has this name, or it cannot be loaded.
        """
        return load(self.target(name), f"{self.what} {name!r}")
