"""Ways that come in: what went out comes back, look-alikes of data sets and bags are placed, what is wrong is said."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from common import refused
from exchange_support import recorded
from skd_adversary.safe_trajectories.sources import load_safe_trajectories
from skd_evaluator.assessment.files.episodes_npz import read_episodes
from skd_evaluator.bags.tracks import Track
from skd_evaluator.extensions.exchange.exports import FORMATS
from skd_evaluator.extensions.exchange.imports import UnusableError, by_car
from skd_evaluator.extensions.exchange.readers import ImportRequest, read_sources
from skd_sim import load_scenario


@pytest.mark.parametrize("name", FORMATS)
def test_import_of_an_export_gives_the_phi_that_went_out(result: Path, skd_here, tmp_path: Path, name: str):
    assert skd_here("export", result, "--format", name, "--out", "out").returncode == 0
    done = skd_here("import", "out", "--out", "in", "--scenario", "bystanders", "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    phis = read_episodes(result).safe
    assert [Path(one["file"]).stem for one in content["files"]] == [f"phi_{index:03d}" for index in range(len(phis))]
    assert len(content["left_out"]) == 8  # kamikazes are no safe trajectories
    kamikaze = next(path for path in sorted((tmp_path / "out").iterdir()) if "kamikaze" in path.name)
    done = skd_here("import", kamikaze, "--out", "none")
    assert (done.returncode, "it is no safe trajectory" in done.stderr) == (2, True)
    scenario = load_scenario("bystanders")
    found = load_safe_trajectories(tmp_path / "in" / "safe", scenario, len(phis))
    for one, phi in zip(found, phis, strict=True):
        assert one.positions == pytest.approx(phi, abs=1e-9)
        assert len(one) == len(phi)


@pytest.mark.parametrize("name", FORMATS)
def test_every_kind_comes_back(tmp_path: Path, name: str):
    """A bicycle, cars and children, on curves and on crossing roads; times to a nanosecond."""
    kind = FORMATS[name]
    for scenario in ("cbna", "cccscp", "right_turn", "child", "oncoming_turn"):
        one = recorded(scenario, whole_ticks=kind.whole_ticks, stem=scenario)
        path = tmp_path / kind.name(one)
        kind.write(path, one)
        (source,) = read_sources([path], ImportRequest(needs_car=True))
        assert source.stem == scenario
        user = next(actor for actor in one.actors if actor.name == "Adversary")
        assert source.found.times == pytest.approx(user.times, abs=1e-9)
        assert source.found.places == pytest.approx(user.states[:, :2], abs=1e-9)
        assert len(source.car.times) == len(user.times)


def look_alike(folder: Path, *, rate: float = 25.0, drop: tuple[int, ...] = (), mirror: float = 1.0) -> Path:
    """A recording in the layout of inD: a car that drives along a street, a pedestrian, a cyclist; made up here."""
    folder.mkdir(exist_ok=True)
    turned, origin = 0.6, np.array([120.0, -45.0])
    to_file = np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    frames = np.arange(0, 251)
    ways = {  # in a frame in which the car drives North
        "3": ("car", np.column_stack([0.0 * frames, -30.0 + 8.0 * frames / rate])),
        "5": ("pedestrian", np.column_stack([mirror * (-4.0 + 1.2 * frames / rate), 0.3 * np.sin(frames / 40.0)])),
        "7": ("bicycle", np.column_stack([-6.0 + 4.0 * frames / rate, 0.0 * frames + 9.0])),
    }
    further = "trackLifetime,width,length,xVelocity,yVelocity,xAcceleration,yAcceleration,lonVelocity,latVelocity"
    lines = [f"recordingId,trackId,frame,xCenter,yCenter,heading,{further}"]
    for id_, (_, way) in ways.items():
        for frame, (x, y) in zip(frames.tolist(), (way @ to_file.T + origin).tolist(), strict=True):
            if not (id_ == "5" and frame in drop):
                lines.append(f"18,{id_},{frame + 100},{x!r},{y!r},0.0,{frame},0,0,0,0,0,0,0,0")
    (folder / "18_tracks.csv").write_text("\n".join(lines) + "\n")
    meta = ["recordingId,trackId,initialFrame,finalFrame,numFrames,width,length,class"]
    meta += [f"18,{id_},100,350,251,0,0,{kind}" for id_, (kind, _) in ways.items()]
    (folder / "18_tracksMeta.csv").write_text("\n".join(meta) + "\n")
    (folder / "18_recordingMeta.csv").write_text(f"recordingId,locationId,frameRate\n18,1,{rate:g}\n")
    return folder


def test_data_sets_of_levelx_are_placed_by_a_frame_or_by_the_car(tmp_path: Path, skd_here):
    look_alike(tmp_path / "ind", drop=(40, 41))
    frame = f"120,-45,{math.degrees(0.6)!r}"
    done = skd_here("import", "ind", "--frame", frame, "--out", "a", "--json")
    assert done.returncode == 0, done.stderr
    (one,) = json.loads(done.stdout)["files"]
    assert (one["road_user"], one["kind"], one["positions"], one["gaps"]) == ("5", "pedestrian", 249, 1)
    assert one["rate"] == pytest.approx(25.0)
    assert one["longest_step"] == one["filled"] == pytest.approx(3 / 25)
    table = np.loadtxt(tmp_path / "a" / "safe" / "18_tracks_5.csv", delimiter=",", skiprows=1)
    assert table[:, 1] == pytest.approx(-4.0 + 1.2 * table[:, 0], abs=1e-9)
    assert table[:, 2] == pytest.approx(0.3 * np.sin(25.0 * table[:, 0] / 40.0), abs=1e-9)
    scenario = ("--scenario", "crossing")
    done = skd_here("import", "ind", "--road-user", 5, "--car", 3, "--frame", "car", *scenario, "--out", "b", "--json")
    assert done.returncode == 0, done.stderr
    by_car = np.loadtxt(tmp_path / "b" / "safe" / "18_tracks.csv", delimiter=",", skiprows=1)
    assert by_car[:, 1] == pytest.approx(table[:, 1], abs=1e-9)
    moved = by_car[:, 2] - table[:, 2]
    assert np.ptp(moved) < 1e-9  # y = 0 where it crosses the car's line
    assert np.interp(0.0, by_car[:, 1], by_car[:, 2]) == pytest.approx(0.0, abs=1e-9)
    look_alike(tmp_path / "west", mirror=-1.0)
    done = skd_here("import", "west", "--road-user", 5, "--car", 3, "--frame", "car", "--out", "c")
    assert "mirrored to cross eastwards" in done.stdout
    bikes = skd_here("import", "ind", "--kind", "cyclist", "--out", "d", "--json")
    assert [one["road_user"] for one in json.loads(bikes.stdout)["files"]] == ["7"]


def test_long_gaps_jumps_and_what_safe_refuses_are_left_out(tmp_path: Path, skd_here):
    look_alike(tmp_path / "ind", drop=tuple(range(40, 60)))
    done = skd_here("import", "ind", "--out", "a")
    assert (done.returncode, "a gap of 0.84 s" in done.stderr, (tmp_path / "a").exists()) == (2, True, False)
    done = skd_here("import", "ind", "--longest-gap", 1, "--out", "a")
    assert "1 gap, 0.84 s in all, filled in straight lines" in done.stdout
    done = skd_here("import", "ind", "--longest-gap", 1, "--scenario", "crossing", "--out", "b")
    assert (done.returncode, "nothing is left" in done.stderr) == (2, True)  # 120 m away
    look_alike(tmp_path / "slow", rate=15.0)
    frame = f"120,-45,{math.degrees(0.6)!r}"
    done = skd_here("import", "slow", "--frame", frame, "--scenario", "crossing", "--out", "c", "--json")
    (one,) = json.loads(done.stdout)["files"]
    assert one["cut"].startswith("cut to the horizon")  # 16.7 s, of which 12 s are around the crossing
    table = np.loadtxt(tmp_path / "c" / one["file"], delimiter=",", skiprows=1)
    assert table[-1, 0] <= 12.0 + 1e-9
    assert table[0, 1] < 0.0 < table[-1, 1]


def test_the_same_way_comes_in_once(tmp_path: Path, skd_here):
    """`--safe` refuses a way that is there twice, and some of the φ that SKD draws are the same."""
    times = np.arange(0.0, 2.41, 0.3)
    for name, rate in (("first", 1), ("second", 1), ("finer", 2)):
        at = np.linspace(0.0, times[-1], rate * (len(times) - 1) + 1)
        rows = [f"{t!r},{x!r},0.0" for t, x in zip(at.tolist(), (2.5 * at - 3.0).tolist(), strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["t,x,y", *rows]) + "\n")
    files = ["first.csv", "finer.csv", "second.csv"]
    done = skd_here("import", *files, "--out", "a", "--json")
    content = json.loads(done.stdout)
    assert [one["source"] for one in content["files"]] == ["first.csv", "finer.csv"]
    (one,) = content["left_out"]
    assert (one["source"], one["why"].split(",")[0]) == ("second.csv", "is the trajectory of first.csv once more")
    done = skd_here("import", *files, "--scenario", "crossing", "--out", "b")  # at its ticks all three are the same
    assert sorted(path.name for path in (tmp_path / "b" / "safe").iterdir()) == ["first.csv"]
    assert done.stderr.count("left out: is the trajectory of first.csv once more") == 2
    assert "--safe-count 1 " in done.stdout
    assert len(load_safe_trajectories(tmp_path / "b" / "safe", load_scenario("crossing"), 1)) == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<Other/>", "its root is 'Other'"),
        ("<OpenSCENARIO><a>", "not XML that SKD reads"),
        ("a,b\n1,2\n", "line 1: the header must name"),
        ("t,x,y\n0,0,0\n", "1 position; a track has at least two"),
        ("t,x,y\n0,0,0\n1,zero,0\n", "line 3: x must be a number"),
        ("t,x,y\n0,0,0\n0,1,0\n", "in two places, 1 m apart, at 0.00 s"),
        ("t,id,x,y\n0,a,0,0\n1,a,1,0\n0,b,0,0\n1,b,1,0\n", "name one by --road-user"),
        ("trackId,frame,xCenter,yCenter\n1,0,0,0\n", "called NN_tracks.csv"),
        ("t,x,y\n0,0,-3,5,0,2\n1,0,-2,5,0,2\n", "6 values where the header names 3"),  # decimal commas
    ],
)
def test_files_that_say_no_way(tmp_path: Path, text: str, says: str):
    path = tmp_path / ("a.xosc" if text.startswith("<") else "a.csv")
    path.write_text(text)
    with refused(says):
        read_sources([path], ImportRequest())


def test_a_car_that_turns_does_not_say_where_north_is():
    times = np.linspace(0.0, 8.0, 81)
    turned = 0.5 * np.pi * times / 8.0
    car = Track(times, 20.0 * np.column_stack([1.0 - np.cos(turned), np.sin(turned)]), "car")
    user = Track(times, np.column_stack([-4.0 + times, np.full(81, 10.0)]), "user")
    with pytest.raises(UnusableError, match=r"the car is up to 3.82 m off a straight line"):
        by_car(car, user, 1.0)


def test_what_the_commands_refuse(result: Path, skd_here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for words, says in (
        (("export", result, "--format", "csv", "--episode", 7, "--out", "x"), "holds no such episode"),
        (("export", result, "--format", "csv", "--objective", "none", "--out", "x"), "no episode of that kind"),
        (("export", tmp_path, "--format", "csv", "--out", "x"), "holds no assessment.json"),
        (("import", "nothing", "--out", "x"), "no such file or folder"),
        (("import", tmp_path, "--out", "x"), "no file in it ends in"),
        (("import", result, "--kind", "horse", "--out", "x"), "unknown road user 'horse'"),
    ):
        done = skd_here(*words)
        assert (done.returncode, says in done.stderr, done.stderr.count("\n")) == (2, True, 1), done.stderr
    assert not (tmp_path / "x").exists()

    def missing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr("skd_evaluator.extensions.exchange.osi.import_module", missing)
    done = skd_here("export", result, "--format", "osi", "--out", "x")
    assert (done.returncode, "pip install" in done.stderr) == (2, True)
    assert skd_here("export", result, "--format", "csv", "--worst", 1, "--out", "x").returncode == 0
