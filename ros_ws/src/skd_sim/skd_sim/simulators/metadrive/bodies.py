"""Everybody but the car as MetaDrive has them: upright cylinders and boxes that are put in their places.

Nothing pushes them and they push nothing: they have no contact response, so that a touch does not change where the car
goes before the episode ends with it. Imports MetaDrive.
"""

from __future__ import annotations

from typing import Any, Final

from metadrive.component.traffic_participants.base_traffic_participant import BaseTrafficParticipant
from metadrive.engine.physics_node import BaseRigidBodyNode
from metadrive.type import MetaDriveType
from panda3d.bullet import BulletBoxShape, BulletCylinderShape
from panda3d.core import Vec3

from skd_sim.scenario.kinds import called, height_of
from skd_sim.scenario.road_user import Body
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.metadrive.installed import METADRIVE

Shape = tuple[float, float, float]

LOW: Final = 0.6
"""How high an obstacle is that hides nobody, m: below MetaDrive's lidar, which looks at 1.2 m."""
HIGH: Final = 1.6
"""How high any other obstacle is, m."""


class Placed(BaseTrafficParticipant):
    """A disc or a box of a scenario.

    Attributes:
        MASS: kg; nothing depends on it, but MetaDrive asks for one.
    """

    MASS = 70.0

    def __init__(
        self,
        shape: Shape,
        height: float,
        type_name: str,
        position: tuple[float, float] = (0.0, 0.0),
        heading_theta: float = 0.0,
        random_seed: int | None = None,
        name: str | None = None,
    ) -> None:
        """Make it.

        Args:
            shape: radius, half length, half width (m), as `skd_sim.scenario.road_user.Body.shape`.
            height: how high it is, m.
            type_name: what MetaDrive calls it.
            position: place of its centre in MetaDrive's frame, m.
            heading_theta: heading in MetaDrive's frame, rad.
            random_seed: of MetaDrive's; nothing is drawn.
            name: of MetaDrive's.
        """
        self._shape, self._tall, self._called = shape, height, type_name
        super().__init__(position, heading_theta, random_seed, name)
        self.set_metadrive_type(type_name)
        self.add_body(BaseRigidBodyNode(self.name, type_name))
        radius, half_length, half_width = shape
        solid = (
            BulletCylinderShape(radius, height)
            if radius
            else BulletBoxShape(Vec3(half_length, half_width, 0.5 * height))
        )
        self.body.addShape(solid)
        self.set_static(True)
        self.body.setCollisionResponse(False)
        self.put(*position, heading_theta)

    def put(self, x: float, y: float, heading: float) -> None:
        """Put it at a place (m), pointing along a heading (rad), both in MetaDrive's frame."""
        self.set_position((x, y), 0.5 * self._tall)
        self.set_heading_theta(heading)

    @property
    def TYPE_NAME(self) -> str:  # noqa: N802 - MetaDrive's name
        """What MetaDrive calls it."""
        return self._called

    @property
    def HEIGHT(self) -> float:  # noqa: N802
        """How high it is, m."""
        return self._tall

    @property
    def LENGTH(self) -> float:  # noqa: N802
        """Length of a box, m; of a disc its radius, as MetaDrive's own pedestrian has it for its lidar's sake."""
        return self._shape[0] or 2.0 * self._shape[1]

    @property
    def WIDTH(self) -> float:  # noqa: N802
        """Width of a box, m; of a disc its radius."""
        return self._shape[0] or 2.0 * self._shape[2]


class Cast:
    """Bodies of everybody but the car of a scenario, in an engine's world.

    Attributes:
        adversary: the adversary's.
        others: those of the scenario's others, in its order.
        standing: those of its obstacles, in its order.
    """

    def __init__(self, engine: Any, scenario: Scenario) -> None:
        """Make them."""
        self._engine, self._of = engine, _who(scenario)
        self.adversary = self._put(scenario.adversary.shape, height_of(scenario.adversary.kind), scenario.adversary)
        self.others = [self._put(one.shape, height_of(one.kind), one) for one in scenario.others]
        self.standing = [
            self._put((0.0, 0.5 * one.length, 0.5 * one.width), LOW if one.hides is False else HIGH)
            for one in scenario.obstacles
        ]

    def _put(self, shape: Shape, height: float, who: Body | None = None) -> Placed:
        """Return a body that stands in the engine's world: somebody's, or an obstacle's."""
        type_name = MetaDriveType.TRAFFIC_OBJECT if who is None else called(who, METADRIVE)
        body: Placed = self._engine.spawn_object(
            Placed, force_spawn=True, shape=shape, height=height, type_name=type_name
        )
        return body

    def fits(self, scenario: Scenario) -> bool:
        """Return whether these are the bodies of a scenario, wherever they are."""
        return self._of == _who(scenario)

    @property
    def everybody(self) -> tuple[Placed, ...]:
        """All bodies."""
        return (self.adversary, *self.others, *self.standing)

    def close(self) -> None:
        """Take them out of the world."""
        self._engine.clear_objects([body.id for body in self.everybody], force_destroy=True)


def _who(scenario: Scenario) -> tuple[Any, ...]:
    """Return all of a scenario on which bodies depend."""
    people = [(one.kind, one.shape) for one in (scenario.adversary, *scenario.others)]
    return (*people, *((one.length, one.width, one.hides) for one in scenario.obstacles))
