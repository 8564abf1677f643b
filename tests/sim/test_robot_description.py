"""The URDF of the car: its body is the footprint that collisions are looked for with."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import pytest
from skd_sim.options.options import Frames
from skd_sim.ros.state_publisher import robot_description
from skd_sim.scenario.scenario import load_scenario
from skd_sim.scenario.scenario_file import shipped_scenarios


def numbers(element: ElementTree.Element | None, key: str) -> list[float]:
    assert element is not None
    return [float(word) for word in element.attrib[key].split()]


@pytest.mark.parametrize("name", sorted(shipped_scenarios()))
@pytest.mark.parametrize("part", ["visual", "collision"])
def test_the_body_is_the_footprint_on_the_ground(name: str, part: str) -> None:
    scenario = load_scenario(name)
    body = ElementTree.fromstring(robot_description(scenario)).find(f"link[@name='base_link']/{part}")
    assert body is not None
    middle, size = numbers(body.find("origin"), "xyz"), numbers(body.find("geometry/box"), "size")
    low = [at - 0.5 * extent for at, extent in zip(middle, size, strict=True)]
    high = [at + 0.5 * extent for at, extent in zip(middle, size, strict=True)]
    car = scenario.car
    assert (low[0], high[0]) == pytest.approx((-car.rear, car.front))
    assert (low[1], high[1]) == pytest.approx((-0.5 * car.width, 0.5 * car.width))
    assert low[2] == 0.0


def test_the_links_are_a_tree_of_fixed_joints() -> None:
    robot = ElementTree.fromstring(robot_description(load_scenario("crossing"), Frames(base="car/body", laser="front")))
    assert robot.tag == "robot"
    assert {link.attrib["name"] for link in robot.findall("link")} == {"car/body", "front"}
    (joint,) = robot.findall("joint")
    assert joint.attrib["type"] == "fixed"
    assert [joint.find(end).attrib["link"] for end in ("parent", "child")] == ["car/body", "front"]  # type: ignore[union-attr]
    assert numbers(joint.find("origin"), "xyz")[:2] == [2.25, 0.0]  # sensor.mount_ahead: the bumper of a car of 4.5 m
