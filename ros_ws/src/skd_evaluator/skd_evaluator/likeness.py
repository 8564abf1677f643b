"""What processes, or one campaign today and tomorrow, must have in common for results that are the same to the bit."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import platform
from collections.abc import Mapping
from importlib.metadata import version as version_of
from pathlib import Path

from skd_sim.kernels.arithmetic import arithmetic_digest

from skd_evaluator.version import version

_PACKAGES = ("skd_sim", "skd_adversary", "skd_evaluator")


@functools.cache
def likeness() -> Mapping[str, str]:
    """Return versions and digests, by the name of what they are of."""
    return {
        "SKD": f"{version()} with sources {_sources()[:12]}",
        "Python": platform.python_version(),
        **{name: version_of(name) for name in ("numpy", "scipy", "numba")},
        "platform": f"{platform.system()} on {platform.machine()}",
        "arithmetic": arithmetic_digest()[:12],
    }


def _sources() -> str:
    """Return a digest of every file of SKD's packages."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        spec = importlib.util.find_spec(package)
        assert spec is not None
        assert spec.origin is not None
        folder = Path(spec.origin).parent
        for file in sorted(folder.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(f"{file.relative_to(folder.parent)}\0".encode())
                digest.update(file.read_bytes())
    return digest.hexdigest()
