"""The car under test as a URDF: what `/robot_description` carries.

The body is the footprint of the scenario's car, as high as it is drawn. There are no movable joints, since nothing is
known of the wheels; so no `/joint_states` are needed either.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from skd_sim.options.frames import FRAMES, Frames
from skd_sim.scenario.scenario import Scenario

CAR_HEIGHT = 1.5
"""Of the body, m; it is looked at only."""
LASER_HEIGHT = 0.3
"""Of the scanner above the ground, m: the world is flat, but filters by height take what lies at 0 for the road."""

_LASER_RADIUS, _LASER_LENGTH = 0.05, 0.07  # m


def robot_description(scenario: Scenario, frames: Frames = FRAMES) -> str:
    """Return the URDF of a scenario's car, and of its laser where it has one.

    Args:
        scenario: gives footprint and sensor.
        frames: names of the links.
    """
    car, sensor = scenario.car, scenario.sensor
    robot = ElementTree.Element("robot", name="car_under_test")
    middle = (0.5 * (car.front - car.rear), 0.0, 0.5 * CAR_HEIGHT)
    size = _numbers((car.front + car.rear, car.width, CAR_HEIGHT))
    _link(robot, frames.base, middle, ("box", {"size": size}), "0.29 0.44 0.65 0.9")
    if sensor is not None:
        shape = {"radius": repr(_LASER_RADIUS), "length": repr(_LASER_LENGTH)}
        _link(robot, frames.laser, (0.0, 0.0, 0.0), ("cylinder", shape), "0.1 0.1 0.1 1.0")
        joint = ElementTree.SubElement(robot, "joint", name=f"{frames.laser}_mount", type="fixed")
        ElementTree.SubElement(joint, "parent", link=frames.base)
        ElementTree.SubElement(joint, "child", link=frames.laser)
        ElementTree.SubElement(joint, "origin", xyz=_numbers(laser_mount(scenario)), rpy="0 0 0")
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def laser_mount(scenario: Scenario) -> tuple[float, float, float]:
    """Return where the laser is in the frame of the car, m; it looks straight ahead.

    Raises:
        ValueError: the scenario has no sensor.
    """
    if scenario.sensor is None:
        raise ValueError(f"scenario {scenario.name} has no sensor")
    return scenario.sensor.mount_ahead, 0.0, LASER_HEIGHT


def _link(
    robot: ElementTree.Element,
    name: str,
    middle: tuple[float, float, float],
    shape: tuple[str, dict[str, str]],
    colour: str,
) -> None:
    link = ElementTree.SubElement(robot, "link", name=name)
    for part in ("visual", "collision"):
        element = ElementTree.SubElement(link, part)
        ElementTree.SubElement(element, "origin", xyz=_numbers(middle), rpy="0 0 0")
        ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), shape[0], shape[1])
        if part == "visual":
            material = ElementTree.SubElement(element, "material", name=f"{name}_colour")
            ElementTree.SubElement(material, "color", rgba=colour)


def _numbers(values: tuple[float, float, float]) -> str:
    return " ".join(repr(float(value)) for value in values)
