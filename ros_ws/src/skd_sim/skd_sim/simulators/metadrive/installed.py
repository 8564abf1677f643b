"""Whether MetaDrive is installed, in the version that this adapter was written for. Imports nothing of it."""

from __future__ import annotations

import importlib.metadata
import importlib.util
from typing import Final

from skd_sim.errors import UsageError

METADRIVE: Final = "metadrive"
"""What the simulator is called on the command line."""
VERSION: Final = "0.4.3"
_DISTRIBUTION: Final = "metadrive-simulator"


def require_metadrive() -> None:
    """Refuse to go on without MetaDrive.

    Raises:
        UsageError: it is not installed, or in another version; says how it is installed.
    """
    try:
        found = importlib.metadata.version(_DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        found = ""
    if found != VERSION or importlib.util.find_spec("metadrive") is None:
        there = f"version {found} is installed" if found else "it is not installed"
        raise UsageError(
            f"simulator {METADRIVE} needs MetaDrive {VERSION}, and {there}: in the folder of SKD, "
            '.venv/bin/python -m pip install -e ".[metadrive]" (Python 3.11)'
        )
