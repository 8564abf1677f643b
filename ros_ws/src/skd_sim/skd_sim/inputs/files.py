"""Reading of outside data: files, JSON, XML and numbers, checked; and how names out of them are shown.

Only regular files are opened, for a pipe would never begin, and they are read up to a limit.
"""

from __future__ import annotations

import hashlib
import math
import os
import stat
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO, Any
from xml.etree import ElementTree

from skd_sim.errors import UsageError

LARGEST = 64 * 2**20
"""Bytes that are read of a file unless less is enough; the largest assessment.json that was seen has 3 MiB."""
_BLOCK = 2**20


def open_regular(path: Path) -> IO[bytes]:
    """Open a regular file for reading; reading a pipe or a device might never begin or never end.

    Raises:
        UsageError: it cannot be opened, or is a pipe, a device, a socket or a folder.
    """
    try:
        # Without O_NONBLOCK the opening of a pipe waits for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:  # a name with a zero in it
        raise UsageError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise UsageError(f"{path}: is no regular file; give one")
    return os.fdopen(descriptor, "rb")


def read_bytes(path: Path, largest: int = LARGEST) -> bytes:
    """Return what is in a regular file of at most `largest` bytes.

    Raises:
        UsageError: it is no such file, or cannot be read.
    """
    try:
        with open_regular(path) as stream:
            content = stream.read(largest + 1)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from error
    if len(content) > largest:
        raise UsageError(f"{path}: has more than {_size(largest)}, which no such file needs")
    return content


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a regular file of any size in hexadecimal digits.

    Raises:
        UsageError: it cannot be read, or is no regular file.
    """
    found = hashlib.sha256()
    with open_regular(path) as stream:
        while block := stream.read(_BLOCK):
            found.update(block)
    return found.hexdigest()


def is_there(path: Path) -> bool:
    """Return whether there is something by a name that others wrote; it may be one that nothing can have."""
    try:
        return path.exists()
    except (OSError, ValueError):  # too long, or with a zero in it
        return False


def folders_in(folder: Path, unread: Callable[[Path, str], None]) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Yield a folder and those below it, as `os.walk` does from the top; links are not followed.

    Args:
        folder: where to begin.
        unread: told of a folder that cannot be looked into, and why, in a few words: what is in there is not skipped
            without a word.
    """

    def say(error: OSError) -> None:
        unread(Path(os.fsdecode(error.filename)), f"cannot be looked into ({error.strerror})")

    for path, inside, files in os.walk(folder, onerror=say):
        yield Path(path), inside, files


def from_here(path: str) -> str:
    """Return a word that begins with a path as messages have it: from the current folder on, if the path is in it."""
    return path.removeprefix(f"{Path.cwd()}{os.sep}")


def real_path(path: Path) -> Path:
    """Return where a path leads, with no link in it; one whose links run in a circle leads nowhere, and to itself.

    `Path.resolve` raises RuntimeError there before Python 3.13.
    """
    return Path(os.path.realpath(path))


def read_text(path: Path, largest: int = LARGEST) -> str:
    """Return the text of a regular file of at most `largest` bytes, in UTF-8 with or without a byte-order mark.

    Raises:
        UsageError: it is no such file, or no such text.
    """
    try:
        return read_bytes(path, largest).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not a text file in UTF-8") from error


def read_json(path: Path, largest: int = LARGEST) -> Any:
    """Return the plain data of a JSON file; see `parse_json`.

    Raises:
        UsageError: it cannot be read, is too large, or is no JSON as others may give it.
    """
    return parse_json(read_bytes(path, largest), str(path))


def parse_json(content: bytes | str, where: str) -> Any:
    """Return the plain data that JSON says.

    Args:
        content: content of the file or message.
        where: name of the file or message, for error lines.

    Raises:
        UsageError: it is no JSON (NaN and Infinity are none), or is nested too deeply.
    """
    from pydantic_core import from_json  # slow to import for a help page

    try:
        text = content.decode("utf-8-sig") if isinstance(content, bytes) else content
        return from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise UsageError(f"{where}: not JSON that SKD reads: {' '.join(str(error).split())[:160]}") from error


def read_xml(path: Path, largest: int = LARGEST) -> ElementTree.Element:
    """Return the root of an XML file; names have no namespaces.

    Raises:
        UsageError: it cannot be read, is too large, or is no XML.
    """
    content = read_bytes(path, largest)
    try:
        root = ElementTree.fromstring(content)  # expat refuses entities that grow
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # LookupError: an unknown encoding
        raise UsageError(f"{path}: not XML that SKD reads: {' '.join(str(error).split())[:160]}") from error
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


def _size(count: int) -> str:
    return f"{count // 2**20} MiB" if count >= 2**20 else f"{count // 1024} KiB"


def finite_number(text: str, what: str) -> float:
    """Return the number that a text says.

    Args:
        text: as it stands in the file.
        what: it is, and where, for messages.

    Raises:
        UsageError: it is none, or is not finite.
    """
    try:
        value = float(text.replace("_", "?"))  # Python takes 1_0 for 10
    except ValueError:
        raise UsageError(f"{what} must be a number, got {text[:40]!r}") from None
    if not math.isfinite(value):
        raise UsageError(f"{what} must be finite, got {text[:40]}")
    return value


def printable(text: str) -> str:
    """Return text in which control and format characters are written as escapes, but for tabs and ends of lines."""
    if text.isprintable():
        return text
    return "".join(
        one.encode("unicode_escape").decode() if unicodedata.category(one)[0] == "C" and one not in "\n\t" else one
        for one in text
    )


def one_line(text: str) -> str:
    """Return the same in one line: what begins a new one is a blank."""
    return printable(" ".join(text.splitlines()))


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is nearest; none where none is near."""
    from difflib import get_close_matches  # only where something is wrong

    by_case = {one.lower(): one for one in known}
    near = get_close_matches(name.lower(), by_case, n=1, cutoff=0.6)
    return by_case[near[0]] if near else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` with the known name that is nearest; empty where none is near."""
    near = nearest(name, known)
    return "" if near is None else f"; did you mean {near!r}?"


def near_or_all(name: str, known: Iterable[str], word: str) -> str:
    """Return `did_you_mean`, or where nothing is near all that is known, after a word."""
    names = list(known)
    return did_you_mean(name, names) or f"; {word} {', '.join(names)}"
