"""How people deviate from the way that they intend: models as data, and what a person walks by one."""

from __future__ import annotations

from typing import Final

WALKERS: Final = "walkers"
"""The model that comes with SKD."""
NO_BEHAVIOUR: Final = "none"
"""No model, and so no risk."""
