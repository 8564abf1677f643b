import math
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from citr_lookalike import LookAlike, Walk
from common import refused
from skd_adversary.safe_trajectories.sources import Clip, read_clips, select, touches_cart
from skd_sim import Scenario, Trajectory, load_scenario
from skd_sim.controllers.basic import PAPER_MULTIPLIERS

SCENARIO = load_scenario("citr_crossing")


def read_citr(folder: Path, scenario: Scenario) -> list[Trajectory]:
    return select(read_clips(folder), scenario).usable


ANY_ENTRY = replace(SCENARIO, car=replace(SCENARIO.car, meet_safe_trajectory=False))


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("degrees", [0.0, 37.0, 90.0, 178.0, -92.0])
def test_walk_is_recovered_from_any_frame(tmp_path: Path, side: int, degrees: float) -> None:
    walk = Walk(sway=0.0)  # a straight walk, for which linear interpolation is exact
    LookAlike(walks=[walk], side=side, direction=math.radians(degrees)).write(tmp_path)
    (trajectory,) = read_citr(tmp_path, SCENARIO)
    times = SCENARIO.time_step * np.arange(len(trajectory))
    np.testing.assert_allclose(trajectory.positions, walk.at(times), atol=1e-9)
    assert trajectory.name == "yeild_01/1"
    assert trajectory.time_step == SCENARIO.time_step


def test_only_walks_across_the_whole_path_are_kept(tmp_path: Path) -> None:
    edge = SCENARIO.path_edge
    duration = float(LookAlike().seconds()[-1])
    last = math.floor(duration / SCENARIO.time_step) * SCENARIO.time_step
    walks = [
        Walk(start_x=-edge - 0.01),
        Walk(start_x=-edge + 0.01, north=-1.0),
        Walk(start_x=edge + 0.01 - 1.4 * last),
        Walk(start_x=edge - 0.01 - 1.4 * last, north=-1.0),
    ]
    # Drives away from the pedestrians, so that nothing else drops any; nor does their early entry, in this scenario.
    LookAlike(walks=walks, cart_y=10.0).write(tmp_path)
    usable, dropped = select(read_clips(tmp_path), ANY_ENTRY)
    assert [trajectory.name for trajectory in usable] == ["yeild_01/1", "yeild_01/3"]
    assert dropped == [("yeild_01/2", "starts in the car's path"), ("yeild_01/4", "ends before the far side")]


@pytest.mark.parametrize(("margin", "touches"), [(-0.02, True), (0.02, False)])
def test_contact_with_the_recorded_cart(tmp_path: Path, margin: float, touches: bool) -> None:
    # Straight East along y = 0, past a cart at a crawl whose front is at y = −radius − margin when the disc's
    # centre leaves the cart's width: contact if and only if the margin is negative.
    walk = Walk(drift=0.0, sway=0.0)
    crossing_time = -walk.start_x / walk.speed
    slow = 0.2
    radius = SCENARIO.adversary.radius
    leave = crossing_time + 0.6 / walk.speed  # the disc's centre leaves the cart's width
    LookAlike(walks=[walk], cart_speed=slow, cart_y=-1.0 - radius - margin - slow * leave).write(tmp_path)
    (clip,) = read_clips(tmp_path)
    assert touches_cart(clip, clip.tracks[0], radius) is touches
    assert len(read_citr(tmp_path, SCENARIO)) == (0 if touches else 1)


PED, VEH = "unidirection_yeild_01_traj_ped_filtered.csv", "unidirection_yeild_01_traj_veh_filtered.csv"


def _spoil(file: Path, line: int, old: str, new: str) -> None:
    lines = file.read_text(encoding="utf-8").splitlines()
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new)
    file.write_text("\n".join(lines), encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "line", "old", "new", "message"),
    [
        (PED, 7, ",110,", ",oops,", "line 7: frame must be a number, got 'oops'"),
        (PED, 7, ",110,", ",109,", "line 7: frame of id 1 must increase strictly"),
        (VEH, 3, ",2.0", ",nan", "line 3: vel_est must be finite, got nan"),
        (VEH, 1, "psi_est", "heading", "line 1: no column 'psi_est'"),
        (VEH, 3, "1,106,", "2,106,", "one vehicle expected, got 2"),
    ],
)
def test_malformed_file(tmp_path: Path, name: str, line: int, old: str, new: str, message: str) -> None:
    LookAlike().write(tmp_path)
    _spoil(tmp_path / name, line, old, new)
    with refused(tmp_path / name, message):
        read_citr(tmp_path, SCENARIO)


def _rows(file: Path, change: Callable[[list[str]], list[str]]) -> None:
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    rows = [",".join(change(row.split(","))) for row in rows]
    file.write_text("\n".join([head, *rows]), encoding="utf-8")


def _late(cells: list[str]) -> bool:
    return int(cells[1]) > 200


def _changed(cells: list[str], where: dict[int, Callable[[float], float]]) -> list[str]:
    return [str(where[place](float(one))) if place in where else one for place, one in enumerate(cells)]


MISTAKES: dict[str, tuple[str, Callable[[list[str]], list[str]], str]] = {
    "leaps from then on": (PED, lambda r: _changed(r, {3: lambda x: x + 1.0}) if _late(r) else r, "line 98: moves"),
    "feet": (PED, lambda r: _changed(r, {3: lambda x: x / 0.3048, 4: lambda x: x / 0.3048}), "their velocities"),
    "a hole": (PED, lambda r: [r[0], str(int(r[1]) + 30 * _late(r)), *r[2:]], "line 98: 1.03 s after the row before"),
    "x and y": (PED, lambda r: [*r[:3], r[4], r[3], *r[5:]], "their velocities"),
    "the cart's degrees": (VEH, lambda r: _changed(r, {5: math.degrees}), "their velocities"),
}


@pytest.mark.parametrize(("name", "change", "said"), MISTAKES.values(), ids=MISTAKES)
def test_what_nobody_can_have_done(tmp_path, name, change, said):
    LookAlike().write(tmp_path)
    _rows(tmp_path / name, change)
    with refused(tmp_path / name, said):
        read_clips(tmp_path)


@pytest.fixture(scope="module")
def recorded() -> list[Clip]:
    default = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "citr_vci_lat_uni"
    folder = Path(os.environ.get("SKD_CITR_DIR", default))
    if not folder.is_dir():
        pytest.skip("the CITR dataset is not here; set SKD_CITR_DIR to its vci_lat_uni folder")
    return read_clips(folder)


def test_recorded_trajectories(recorded: list[Clip]) -> None:
    usable, dropped = select(recorded, SCENARIO)
    assert len(usable) + len(dropped) == 64
    assert len(usable) == 35
    assert sum(reason == "ends before the far side" for _, reason in dropped) == 17
    assert sum(reason.startswith("enters the car's path so early") for _, reason in dropped) == 12
    braking = max(PAPER_MULTIPLIERS) * SCENARIO.car.safe_distance
    assert all(SCENARIO.car.start_speed * SCENARIO.end.entry_time(one) >= braking for one in usable)
    edge = SCENARIO.path_edge
    for trajectory in usable:
        x, y = trajectory.positions.T
        assert x[0] < -edge < edge < x[-1]
        assert SCENARIO.end.entry_time(trajectory) > 0.0
        crossing = np.flatnonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))[0]
        assert abs(y[crossing]) < 0.5
        assert np.hypot(*np.diff(trajectory.positions, axis=0).T).max() < 3.0 * SCENARIO.time_step
