"""Which code a package runs: a digest of it, so that processes can tell whether they run the same."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
from pathlib import Path


@functools.cache
def sources_digest(package: str) -> str:
    """Return a digest of every module of a package; an installed one has the same as one in a checkout."""
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    folder = Path(spec.origin).parent
    digest = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        digest.update(f"{file.relative_to(folder).as_posix()}\0".encode() + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def software(packages: tuple[str, ...]) -> str:
    """Return each package with the digest of its code, as `EpisodeReceipt` has it."""
    return " ".join(f"{package}:{sources_digest(package)}" for package in packages)
