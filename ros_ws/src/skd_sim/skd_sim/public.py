"""What a package offers its users by name, imported when it is asked for; and modules under their former names."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any


def exported(package: str, where: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package (PEP 562).

    Args:
        package: name of the package.
        where: name of a thing → module that has it.
    """

    def get(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(where[name]), name)

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *where})

    return get, listed


_FORMER = {
    "skd_sim.compilation": "skd_sim.kernels.compilation",
    "skd_sim.framed_simulator": "skd_sim.simulation.framed_simulator",
    "skd_sim.simulator": "skd_sim.simulation.simulator",
    "skd_sim.trajectory": "skd_sim.geometry.trajectory",
    "skd_sim.world": "skd_sim.simulation.world",
    "skd_adversary.planning.closed_loop": "skd_adversary.planning.general.closed_loop",
    "skd_adversary.planning.model_check": "skd_adversary.planning.general.model_check",
    "skd_adversary.planning.observed_values": "skd_adversary.planning.general.observed_values",
    "skd_adversary.planning.pft_dpw": "skd_adversary.planning.general.pft_dpw",
    "skd_adversary.planning.pomcpow": "skd_adversary.planning.general.pomcpow",
    "skd_evaluator.campaign.rating": "skd_evaluator.campaign.judge.rating",
    "skd_evaluator.campaign.runner": "skd_evaluator.campaign.run.runner",
    "skd_evaluator.campaign.workers": "skd_evaluator.campaign.run.workers",
    "skd_evaluator.measure.clustered": "skd_evaluator.measure.statistics.clustered",
    "skd_evaluator.measure.clustered_rate": "skd_evaluator.measure.statistics.clustered_rate",
    "skd_evaluator.measure.deformation": "skd_evaluator.measure.distances.deformation",
    "skd_evaluator.measure.difference": "skd_evaluator.measure.statistics.difference",
    "skd_evaluator.measure.frechet": "skd_evaluator.measure.distances.frechet",
    "skd_evaluator.measure.measures": "skd_evaluator.measure.distances.measures",
}
"""Modules that users were told to import: name of before → today's."""


class _FormerModules(MetaPathFinder, Loader):
    """Finds a module that has moved where it is today: the same object, whatever name it is imported by."""

    def __init__(self) -> None:
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return ModuleSpec(fullname, self) if fullname in _FORMER else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = importlib.import_module(_FORMER[spec.name])
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give it back its own specification; it has been executed under its own name."""
        assert module.__spec__ is not None
        module.__spec__ = self._specs.pop(module.__spec__.name)


def find_former_modules() -> None:
    """Let modules be found under their former names; last in order, so that no other import is slower."""
    if not any(isinstance(finder, _FormerModules) for finder in sys.meta_path):
        sys.meta_path.append(_FormerModules())
