"""OpenSCENARIO: ASAM's checker takes every file, other readers find the ways in it, and the road is the scenario's."""

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from exchange_support import passes, recorded, safe, scenarios, walk
from skd_evaluator.assessment.files.episodes_npz import read_episodes
from skd_evaluator.extensions.exchange.exports import write_openscenario, write_road
from skd_evaluator.extensions.exchange.scene import stretch
from skd_evaluator.report.repeat import write_trial
from skd_sim import Trajectory, load_scenario
from skd_sim.scenario.road import ONCOMING
from skd_sim.scenario.scenario_file import SCENARIOS


def written(folder: Path, one) -> Path:
    write_road(folder / "road.xodr", [one])
    path = folder / f"{one.stem}.xosc"
    write_openscenario(path, one)
    return path


def test_every_scenario_passes_all_checks(tmp_path: Path):
    assert len(scenarios()) > 30
    for name in scenarios():
        folder = tmp_path / name
        folder.mkdir()
        assert passes(written(folder, recorded(name))), name
    car_drives_itself = tmp_path / "safe"
    car_drives_itself.mkdir()
    assert passes(written(car_drives_itself, safe("bystanders", walk(load_scenario("bystanders")))))


def test_another_library_reads_each_way_as_it_was(result: Path, skd_here, tmp_path: Path):
    """By scenariogeneration: every ψ, the car beside it, and φ, to 1 µm where 1 mm is asked for."""
    from scenariogeneration import xosc

    done = skd_here("export", result, "--format", "openscenario", "--out", "out", "--json")
    assert done.returncode == 0, done.stderr
    episodes, scenario = read_episodes(result), load_scenario("bystanders")
    numbers = {(str(episodes.objective[k]), int(episodes.episode_id[k])): k for k in range(len(episodes))}
    files = json.loads(done.stdout)["files"]
    kamikazes = [one for one in files if one["mode"] == "kamikaze"]
    assert len(kamikazes) == int((episodes.mode == 1).sum())
    assert len(files) - len(kamikazes) == len(episodes.safe) == 2
    for one in files:
        path = tmp_path / "out" / one["file"]
        assert passes(path)
        scene = xosc.ParseOpenScenario(str(path))
        groups = scene.storyboard.stories[0].acts[0].maneuvergroup
        lines = {}
        for group in groups:
            line = group.maneuvers[0].events[0].action[0].action.trajectory.shapes
            places = np.array([(p.x, p.y) for p in line.positions])
            lines[group.actors.actors[0].entity] = np.array(line.time), places
        if one["mode"] == "safe":
            adversary, car, contact = episodes.safe[one["phi"]], None, None
        else:
            number = numbers[one["objective"], one["episode_id"]]
            adversary, car = episodes.until_contact(number), episodes.car_until_contact(number, scenario)
            contact = float(episodes.impact_time[number]) if episodes.collided[number] else None
        times, places = lines["Adversary"]
        assert np.abs(places - adversary).max() < 1e-6
        assert times[:-1] == pytest.approx(episodes.time_step * np.arange(len(times) - 1), abs=1e-9)
        assert times[-1] == pytest.approx(episodes.time_step * (len(times) - 1) if contact is None else contact)
        assert ("Ego" in lines) == (car is not None)
        if car is not None:
            assert np.abs(lines["Ego"][1] - car[:, :2]).max() < 1e-6
        assert {"Other_3", "Other_4"} <= set(lines)  # who walks, and who drives; the other two stand
        assert "Other_1" not in lines


def test_two_exports_are_the_same_to_the_byte_and_the_car_can_be_left_out(result: Path, skd_here, tmp_path: Path):
    for out, more in (("a", ()), ("b", ()), ("c", ("--no-car",))):
        words = ("export", result, "--format", "openscenario", "--worst", "2", *more)
        assert skd_here(*words, "--out", out).returncode == 0
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    first, second = ([(tmp_path / out / name).read_bytes() for name in names] for out in "ab")
    assert first == second
    (episode, *_) = (name for name in names if name.startswith("kamikaze"))
    root = ElementTree.parse(tmp_path / "c" / episode).getroot()
    driven = [one.get("entityRef") for one in root.iter("EntityRef")]
    assert "Ego" not in driven
    assert "Adversary" in driven
    begins = {one.get("entityRef") for one in root.iter("Private")}
    assert "Ego" in begins  # where it begins, and how fast, is said


def test_the_trial_of_a_comparison_or_a_log_goes_out_to_the_last_bit(skd_here, tmp_path: Path):
    scenario = load_scenario("bystanders")
    write_trial(tmp_path, scenario, Trajectory(walk(scenario), scenario.time_step))
    words = ("export", tmp_path, "--format", "openscenario", "--out", "out")
    assert skd_here(*words, "--worst", "1").returncode == 2
    assert skd_here(*words).returncode == 0
    assert passes(tmp_path / "out" / "trial.xosc")
    root = ElementTree.parse(tmp_path / "out" / "trial.xosc").getroot()
    (line,) = (one for one in root.iter("Trajectory") if one.get("name", "").endswith("Adversary"))
    times = [float(one.get("time", "nan")) for one in line.iter("Vertex")]
    places = [[float(one.get(key, "nan")) for key in "xy"] for one in line.iter("WorldPosition")]
    written = np.loadtxt(tmp_path / "trajectory.csv", delimiter=",", skiprows=1)
    assert np.array_equal(np.column_stack([times, places]), written)


def points_of(road: ElementTree.Element, spacing: float = 0.1) -> np.ndarray:
    """Points on the reference line of an OpenDRIVE road, each with its heading: (s, x, y, heading), by the standard."""
    rows = []
    for one in road.findall("planView/geometry"):
        s, x, y, heading, length = (float(one.get(key, "nan")) for key in ("s", "x", "y", "hdg", "length"))
        arc = one.find("arc")
        for along in np.arange(0.0, length, spacing).tolist():
            if arc is None:
                rows.append((s + along, x + along * math.cos(heading), y + along * math.sin(heading), heading))
            else:
                k = float(arc.get("curvature", "nan"))
                turned = heading + k * along
                east = (math.sin(turned) - math.sin(heading)) / k
                north = (math.cos(heading) - math.cos(turned)) / k
                rows.append((s + along, x + east, y + north, turned))
    return np.array(rows)


@pytest.mark.parametrize("name", SCENARIOS.own)
def test_the_lanes_of_the_road_are_those_of_the_scenario(name: str, tmp_path: Path):
    """Edges from lane offset and widths, as OpenDRIVE counts them, against the scenario's own; in metres."""
    one = recorded(name)
    write_road(tmp_path / "road.xodr", [one])
    scenario, root = one.scenario, ElementTree.parse(tmp_path / "road.xodr").getroot()
    roads = root.findall("road")
    elsewhere = [number for number, lane in scenario.road.every_lane.items() if not lane.beside]
    assert len(roads) == 1 + len(elsewhere)
    beside = [number for number in sorted(scenario.road.every_lane) if number not in elsewhere]
    for road, numbers in zip(roads, [beside, *([number] for number in elsewhere)], strict=True):
        low, _ = stretch(scenario, [one], numbers[0])
        line = points_of(road)
        (offset,) = (float(found.get("a", "nan")) for found in road.iter("laneOffset"))
        lanes = [lane for lane in road.iter("lane") if lane.get("id") != "0"]
        right = {int(lane.get("id", "0")): float(lane[0].get("a", "nan")) for lane in lanes}
        edges, at = {0: -offset}, -offset
        for number in sorted((n for n in right if n < 0), reverse=True):
            at += right[number]
            edges[number] = at
        at = -offset
        for number in sorted(n for n in right if n > 0):
            at -= right[number]
            edges[number] = at
        assert len(right) == len(numbers)
        found = sorted(edges.values())  # to the right of the reference line, from left to right
        sides = [(n, side) for n in numbers for side in (-0.5, 0.5)]
        wanted = sorted({round(scenario.road.offset(n) + side * scenario.road.width(n), 9) for n, side in sides})
        assert found == pytest.approx(wanted, abs=1e-9)
        for row in (0, len(line) // 2, len(line) - 1):
            s, x, y, heading = line[row]
            expected = scenario.road.place(numbers[0], low + s)
            here = scenario.road.offset(numbers[0])
            place = x + here * math.sin(heading), y - here * math.cos(heading)
            assert place == pytest.approx(expected[:2], abs=1e-6)
        runs = {n: scenario.road.every_lane[n].direction != ONCOMING for n in numbers}
        for lane in road.iter("lane"):
            number = int(lane.get("id", "0"))
            if number:
                middle = edges[number] + (-0.5 if number < 0 else 0.5) * right[number]
                nearest = min(numbers, key=lambda n: abs(scenario.road.offset(n) - middle))
                assert ((number < 0) != (lane.get("direction") == "reversed")) == runs[nearest]
