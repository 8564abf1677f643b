"""CommonRoad: its own library, and its own schema, take every file; and find the states that were in it."""

import json
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from exchange_support import READERS, recorded, safe, scenarios, walk
from skd_evaluator.extensions.exchange.exports import write_commonroad
from skd_sim.scenario.road import ONCOMING
from skd_sim.scenario.scenario import load_scenario

_READER = """
import json, os, sys
import commonroad
from commonroad.common.file_reader import CommonRoadFileReader
from lxml import etree
folder = os.path.join(list(commonroad.__path__)[0], "common", "xml_definition_files")
schema = etree.XMLSchema(etree.parse(os.path.join(folder, "XML_commonRoad_XSD.xsd")))
found = {}
for path in sys.argv[1:]:
    schema.assertValid(etree.parse(path))
    scenario, problems = CommonRoadFileReader(path).open()
    states = {}
    for one in scenario.dynamic_obstacles:
        every = [one.initial_state, *one.prediction.trajectory.state_list]
        states[one.obstacle_id] = [
            (s.time_step, *map(float, s.position), float(s.orientation), float(s.velocity)) for s in every
        ]
    found[os.path.basename(path)] = {
        "dt": scenario.dt, "states": states, "lanelets": len(scenario.lanelet_network.lanelets),
        "static": {one.obstacle_id: list(map(float, one.initial_state.position)) for one in scenario.static_obstacles},
        "problems": len(problems.planning_problem_dict),
        "types": {one.obstacle_id: one.obstacle_type.value for one in scenario.obstacles},
    }
print(json.dumps(found))
"""


@pytest.mark.skipif(not READERS.exists(), reason="no commonroad-io: scripts/exchange-readers makes .venv-readers")
def test_its_own_library_reads_the_same_states(tmp_path: Path):
    every = {name: recorded(name, whole_ticks=True, stem=name) for name in scenarios()}
    every["safe"] = safe("crossing", walk(load_scenario("crossing")))
    paths = []
    for name, one in every.items():
        paths.append(tmp_path / f"{name}.xml")
        write_commonroad(paths[-1], one)
    done = subprocess.run([READERS, "-c", _READER, *paths], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.strip().splitlines()[-1])
    for name, one in every.items():
        said = found[f"{name}.xml"]
        assert (said["dt"], said["problems"]) == (one.scenario.time_step, 1)
        assert said["lanelets"] == len(one.scenario.road.every_lane)
        for actor in one.actors:
            if actor.stands:
                assert said["static"][str(actor.number)] == actor.centres[0].tolist()
                continue
            rows = np.array(said["states"][str(actor.number)])
            assert rows[:, 0].tolist() == list(range(len(actor.times)))
            assert np.array_equal(rows[:, 1:3], actor.centres)
            assert np.cos(rows[:, 3] - actor.states[:, 2]) == pytest.approx(1.0)
            assert np.array_equal(rows[:, 4], actor.states[:, 3])


def test_lanelets_lead_the_way_their_lanes_do(tmp_path: Path):
    """Left of its own way is its left bound, for those of oncoming traffic too."""
    for name in scenarios():
        one = recorded(name, whole_ticks=True)
        write_commonroad(tmp_path / "one.xml", one)
        root = ElementTree.parse(tmp_path / "one.xml").getroot()
        numbers = sorted(one.scenario.road.every_lane)
        for number, lanelet in zip(numbers, root.findall("lanelet"), strict=True):
            sides = [lanelet.findall(f"{side}/point") for side in ("leftBound", "rightBound")]
            bounds = [np.array([[float(one.findtext(axis, "nan")) for axis in "xy"] for one in side]) for side in sides]
            ahead = bounds[0][1] - bounds[0][0]
            right = bounds[1][0] - bounds[0][0]
            assert ahead[0] * right[1] - ahead[1] * right[0] < 0.0
            heading = one.scenario.road.place(number, 0.0)[2]
            middle = 0.5 * (bounds[0] + bounds[1])
            nearest = int(np.argmin(np.hypot(*(middle - one.scenario.road.place(number, 0.0)[:2]).T)))
            step = middle[min(nearest + 1, len(middle) - 1)] - middle[max(nearest - 1, 0)]
            assert step @ [np.cos(heading), np.sin(heading)] > 0.0
            for tag in ("adjacentLeft", "adjacentRight"):
                beside = lanelet.find(tag)
                if beside is not None:
                    other = one.scenario.road.every_lane[numbers[int(beside.get("ref", "0")) - 10_001]]
                    same = (other.direction == ONCOMING) == (one.scenario.road.every_lane[number].direction == ONCOMING)
                    assert beside.get("drivingDir") == ("same" if same else "opposite")
