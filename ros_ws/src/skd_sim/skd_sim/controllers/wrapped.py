"""What every controller around another one says of it, so that it is asked as the one inside wants to be."""

from __future__ import annotations

from skd_sim.controllers.protocol import control_period_of, takes_batches, takes_scene


class WrappedController:
    """The base of those who guard, watch or overhear a controller: they decide as often as it, and see as much."""

    def __init__(self, controller: object, name: str) -> None:
        """Stand around `controller`, called `name` in messages."""
        self._inner, self._name = controller, name

    @property
    def control_period(self) -> float | None:
        """The one that the controller declares, s; none by default."""
        return control_period_of(self._inner, self._name)

    @property
    def takes_scene(self) -> bool:
        """Whether the controller wants to see everybody."""
        return takes_scene(self._inner)

    @property
    def takes_batches(self) -> bool:
        """Whether the controller answers many episodes at once."""
        return takes_batches(self._inner)
