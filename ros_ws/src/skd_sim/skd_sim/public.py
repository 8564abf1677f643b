"""What a package offers its users by name, imported when it is requested (PEP 562)."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any


def exported(package: str, file: str) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__all__`, `__getattr__` and `__dir__` of a package whose names its stub imports.

    Args:
        package: name of the package.
        file: its `__init__.py`, beside which the stub is.
    """
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    where = {name.name: str(one.module) for one in stub.body if isinstance(one, ast.ImportFrom) for name in one.names}

    def get(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(where[name]), name)

    return sorted(where), get, lambda: sorted({*vars(importlib.import_module(package)), *where})
