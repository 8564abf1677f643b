"""Compiled kernels on disk: one file per kernel, argument types and machine, named by all that its code depends on.

Files are unpickled, which runs whatever they say: so the folder has to be ours, and closed to everybody else.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import io
import os
import pickle
import re
import shutil
import stat
import sys
import tempfile
import uuid
from pathlib import Path
from typing import Any, NamedTuple

from numba.core import serialize
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher

from skd_sim.kernels import anew
from skd_sim.kernels.compiler.fingerprint import UnfathomableError, argument_shapes, fingerprint

VARIABLE = "SKD_CACHE_DIR"
_FOLDER = "kernels"
_CHECKSUM = 32  # bytes in front of each file


class _Folder(NamedTuple):
    """The folder of compiled kernels, held open: what is checked is what is read, whatever becomes of its name."""

    path: Path
    descriptor: int


class RefusedError(OSError):
    """A folder that others may have written to."""


@functools.cache
def cache_folder() -> _Folder | None:
    """Return the folder for compiled kernels: in $SKD_CACHE_DIR, else in the user's cache; none where nothing is left.

    One that is not ours alone is not used: a temporary one takes its place, which other programs that this one starts
    share and which goes with it, and a line on standard error says so.
    """
    try:
        root = os.environ.get(VARIABLE)
        base = Path(root) if root else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "skd"
        return _open(base / _FOLDER)
    except (OSError, RuntimeError) as error:  # the latter where nobody knows a home
        reason = str(error)
    try:
        private = Path(tempfile.mkdtemp(prefix="skd-"))
        atexit.register(_remove, private, os.getpid())
        os.environ[VARIABLE] = str(private)
        folder: _Folder | None = _open(private / _FOLDER)
    except OSError:
        folder = None
    print(
        f"skd: warning: {reason}; so kernels are compiled anew at each start, which takes about a minute: set "
        f"{VARIABLE} to a folder of your own",
        file=sys.stderr,
    )
    return folder


def _open(path: Path) -> _Folder:
    """Return a folder that is ours and closed to others, made where it is missing.

    Raises:
        RefusedError: it belongs to somebody else, is open to others, or is a link.
        OSError: it cannot be made, or not be written to.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    if path.is_symlink():
        raise RefusedError(f"{path} is a link, which others may turn elsewhere")
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    found = os.fstat(descriptor)
    if found.st_uid != os.geteuid():
        os.close(descriptor)
        raise RefusedError(f"{path} belongs to another user (id {found.st_uid})")
    if stat.S_IMODE(found.st_mode) & 0o077:
        os.close(descriptor)
        raise RefusedError(f"{path} is open to other users (mode {stat.S_IMODE(found.st_mode):o}, not 700)")
    if not os.access(path, os.W_OK | os.X_OK):
        os.close(descriptor)
        raise RefusedError(f"{path} cannot be written to")
    return _Folder(path, descriptor)


_NumbaPickler: Any = serialize.NumbaPickler  # numba has no types for it


class _Pickler(_NumbaPickler):  # type: ignore[misc]
    """Names the classes of the program that is run, where numba would copy them.

    The parameters of a kernel would be of the copy, when it is read again, and no other kernel's.
    """

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, type):
            name = value.__qualname__
            if getattr(sys.modules["__main__"], name, None) is value:
                return name
        return super().reducer_override(value)


def _pickled(value: Any) -> bytes:
    buffer = io.BytesIO()
    pickler: Any = _Pickler
    pickler(buffer, protocol=4).dump(value)
    return buffer.getvalue()


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:  # not at the end of a worker forked from it
        shutil.rmtree(folder, ignore_errors=True)


def is_kept(kernel: Any) -> bool:
    """Return whether code of a kernel is in the folder, for some types of arguments, of this version or another.

    What the kernel depends on is not looked at, which takes longer: who asks wants to know whether this is a first run.
    """
    folder, function = cache_folder(), getattr(kernel, "py_func", None)
    if folder is None or function is None:
        return True
    begin = f"{_readable(function)}-"
    with os.scandir(folder.descriptor) as entries:
        return any(entry.name.startswith(begin) for entry in entries)


def _readable(function: Any) -> str:
    """Return what names of files say of a function."""
    return re.sub(r"[^\w.]", "", f"{function.__module__}.{function.__qualname__}", flags=re.ASCII)[:100]


class KernelCache:
    """Compiled code of one kernel, for numba's dispatcher, which asks it for each tuple of argument types.

    A file that is missing, damaged or not ours means compiling; one that cannot be written, compiling again next time.
    """

    def __init__(self, kernel: Dispatcher) -> None:
        """Serve a kernel; its closure is looked at when it is first called, when all of it is defined."""
        self._kernel = kernel
        self._plain: Any = kernel.py_func
        self._closure: str | None = None
        self._looked = False

    @property
    def cache_path(self) -> str:
        """The folder, for numba's statistics."""
        folder = cache_folder()
        return str(folder.path) if folder else ""

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return what was compiled for a signature; None where there is nothing."""
        target.refresh()
        found = self._load(signature, target)
        if found is None:
            anew.note(self._plain.__qualname__)
        return found

    def _load(self, signature: Any, target: Any) -> Any:
        name, folder = self._file_name(signature, target.codegen()), cache_folder()
        if name is None or folder is None:
            return None
        try:
            descriptor = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder.descriptor)
        except OSError:
            return None
        with os.fdopen(descriptor, "rb") as file:
            found = os.fstat(descriptor)
            if found.st_uid != os.geteuid() or not stat.S_ISREG(found.st_mode):
                return None
            content = file.read()
        if hashlib.sha256(content[_CHECKSUM:]).digest() != content[:_CHECKSUM]:
            return None
        try:
            parts = pickle.loads(content[_CHECKSUM:])
        except AttributeError:  # it names a class of a program, and this is another program
            return None
        rebuild: Any = CompileResult._rebuild  # numba has no types for it
        compiled = rebuild(target, *parts)
        # A program's class of that name may be another one.
        return compiled if compiled.signature.args == tuple(getattr(signature, "args", signature)) else None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep what was compiled for a signature."""
        name, folder = self._file_name(signature, compiled.codegen), cache_folder()
        if name is None or folder is None:
            return
        if compiled.library.has_dynamic_globals or any(not one.can_cache for one in compiled.lifted):
            return  # holds addresses of this process
        content = _pickled(compiled._reduce())
        temporary: str | None = f".{uuid.uuid4().hex}"
        place = folder.descriptor
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        with contextlib.suppress(OSError):
            try:
                with os.fdopen(os.open(str(temporary), flags, 0o600, dir_fd=place), "wb") as file:
                    file.write(hashlib.sha256(content).digest() + content)
                os.replace(str(temporary), name, src_dir_fd=place, dst_dir_fd=place)
                temporary = None
            finally:
                if temporary is not None:
                    os.unlink(temporary, dir_fd=place)

    def _file_name(self, signature: Any, codegen: Any) -> str | None:
        """Return the name of the file for a signature; None where the kernel's code must not be kept."""
        if not self._looked:
            self._looked = True
            with contextlib.suppress(UnfathomableError):
                self._closure = fingerprint(self._kernel)
        if self._closure is None:
            return None
        try:
            shapes = " ".join(map(argument_shapes, getattr(signature, "args", signature)))
        except UnfathomableError:
            return None
        key = hashlib.sha256(f"{self._closure} {shapes} {codegen.magic_tuple()}".encode()).hexdigest()[:40]
        return f"{_readable(self._plain)}-{key}.kernel"
