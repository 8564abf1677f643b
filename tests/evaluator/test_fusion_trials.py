"""Physical trials from tables, tracks and bags: what is measured in them, and what is refused."""

import json
import math
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from common import run_skd
from skd_evaluator import Plan, load_result, run_episode
from skd_evaluator.bags.tracks import RecordingFrame
from skd_evaluator.extensions.fusion.recordings import TrialRecorder, overruled
from skd_evaluator.extensions.fusion.trials import PhysicalTrial, read_trials, table_in
from skd_evaluator.metrics.surrogate_measures import least_clearance
from skd_evaluator.metrics.surrogate_scenes import scene_of
from skd_sim import Mode, Trajectory, UsageError, load_scenario
from skd_sim.scenario.scenario import scenario_from_dict

pytestmark = pytest.mark.usefixtures("pictures_drawn")

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "proving_ground" / "drive.py"
SCENARIO = load_scenario("crossing")
PHI = np.column_stack([np.linspace(-3.5, 2.5, 15), np.zeros(15)])
SPEED, GAP = 6.0, 20.0  # of a car that keeps its speed
WALKED = 6.0 / (14 * SCENARIO.time_step)


def tracked(
    path: Path,
    *,
    rate: float = 20.0, other_rate: float = 10.0, frame: RecordingFrame = RecordingFrame(),  # noqa: B008
    clock: float = 7.3, gap: float = GAP, speed: float = SPEED, said: float | None = None, aside: float = 0.0,
    ids: tuple[str, str] = ("car", "other"),
) -> Path:  # fmt: skip
    """A table of a car that keeps its speed, and of a road user on φ, who stands before and after."""
    cos, sin = math.cos(frame.turned), math.sin(frame.turned)
    lines = ["t,id,x,y,heading,speed"]

    def put(time: float, name: str, x: float, y: float, further: str) -> None:
        placed = frame.x + cos * x - sin * y, frame.y + sin * x + cos * y
        lines.append(f"{clock + time!r},{name},{placed[0]!r},{placed[1]!r},{further}")

    ticks = SCENARIO.time_step * np.arange(len(PHI))
    for time in np.arange(-1.0, 5.5, 1.0 / rate).tolist():
        heading = 0.5 * math.pi + frame.turned
        put(time, ids[0], aside, -gap - SCENARIO.car.front + speed * time, f"{heading!r},{said or speed!r}")
    for time in np.arange(-1.0, 5.5, 1.0 / other_rate).tolist():
        put(time, ids[1], float(np.interp(time, ticks, PHI[:, 0])), 0.0, ",")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def recorder(**changes: object) -> TrialRecorder:
    return TrialRecorder(SCENARIO, {"walk": PHI}, **changes)  # type: ignore[arg-type]


def test_a_recording_gives_timing_and_figures_whatever_its_rates_frame_and_clock(tmp_path: Path):
    site = RecordingFrame(120.0, -40.0, 0.7)
    plain = recorder().measured(tracked(tmp_path / "a.csv"), PhysicalTrial("walk"))
    moved = recorder(frame=site, car="ego", other="dummy").measured(
        tracked(tmp_path / "b.csv", rate=50.0, other_rate=25.0, frame=site, clock=1e5, ids=("ego", "dummy")),
        PhysicalTrial("walk"),
    )
    assert plain.gap == pytest.approx(GAP, abs=0.03)
    assert moved.gap == pytest.approx(GAP, abs=0.03)
    for key in ("clearance", "hit"):
        assert moved.values[key] == pytest.approx(plain.values[key], abs=0.03)
    # Who walks leaves the car's strip before the car is there: no car has to brake, and the rest is geometry.
    passed = GAP / SPEED
    assert passed * WALKED - 3.5 > SCENARIO.path_edge
    times = np.linspace(0.0, 14 * SCENARIO.time_step, 200_001)
    x, front = -3.5 + WALKED * times, -GAP + SPEED * times
    ahead = np.maximum(0.0, np.maximum(-front, front - SCENARIO.car.front - SCENARIO.car.rear))
    apart = np.hypot(ahead, np.maximum(0.0, np.abs(x) - SCENARIO.car.half_width)) - SCENARIO.adversary.reach
    assert plain.values["clearance"] == pytest.approx(apart.min(), abs=0.03)
    assert plain.values["hit"] == 0.0


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"said": 3.6 * SPEED}, "is it in km/h"),
        ({"aside": 2.0}, "beside its lane's centre"),
        ({"frame": RecordingFrame(0.0, 0.0, 1.2)}, "off its φ"),
        ({"frame": RecordingFrame(0.0, 3.0, 0.0)}, "off its φ after"),
        ({"ids": ("lead", "dummy")}, "no object 'car' but 'dummy', 'lead'"),
        ({"other_rate": 1.0}, "hole of 1.00 s"),
        ({"speed": 600.0}, "m and times in s"),
        ({"speed": 0.01}, "the car never drives, at most 0.01 m/s, and a hit begins at 0.556 m/s"),
    ],
)
def test_recordings_that_do_not_fit_are_refused(tmp_path: Path, changes, says):
    with pytest.raises(UsageError, match=says):
        recorder().measured(tracked(tmp_path / "a.csv", **changes), PhysicalTrial("walk"))


def kept(path: Path, keep: Callable[[list[str]], bool], out: Path | None = None) -> Path:
    """Write the rows of a table that are to be kept, in place of it or elsewhere."""
    head, *rows = (line.split(",") for line in path.read_text(encoding="utf-8").splitlines())
    out = out or path
    out.write_text("\n".join(map(",".join, [head, *filter(keep, rows)])), encoding="utf-8")
    return out


def test_a_recording_that_ends_while_the_two_come_nearer_is_refused(tmp_path: Path):
    path = kept(tracked(tmp_path / "a.csv"), lambda row: row[1] == "car" or float(row[0]) < 9.8)
    with pytest.raises(UsageError, match=r"ends 1\.\d s before its φ does, and the two still come nearer"):
        recorder().measured(path, PhysicalTrial("walk"))
    assert recorder().laid(path, PhysicalTrial("walk")).times[-1] < 3.0  # enough to calibrate by


@pytest.mark.parametrize("gap", [GAP, SPEED * 3.5 / WALKED], ids=["passed by", "hit"])
def test_a_trial_counts_once(tmp_path: Path, gap: float):
    """Under its name, another way to it, a link and a copy, also one of another clock and one that ends earlier."""
    for name, clock in (("a", 7.3), ("b", 8.3), ("copy", 7.3), ("later", 1e5)):
        tracked(tmp_path / f"{name}.csv", clock=clock, gap=gap + 0.3 * (name == "b"))
    kept(tmp_path / "a.csv", lambda row: float(row[0]) < 11.8, tmp_path / "short.csv")
    (tmp_path / "link.csv").symlink_to("a.csv")
    (tmp_path / "x").mkdir()
    table = tmp_path / "trials.csv"
    for again in ("a", "./a", "x/../a", "link", "copy", "later", "short"):
        files = "".join(f"walk,{name}.csv\n" for name in ("a", "b", again))
        table.write_text(f"phi,file\n{files}", encoding="utf-8")
        with pytest.raises(UsageError, match=r"line 4: is the recording of .*line 2 once more"):
            read_trials(table, recorder().measured)
    table.write_text("phi,file\nwalk,a.csv\nwalk,b.csv\n", encoding="utf-8")
    assert len(read_trials(table, recorder().measured)) == 2


def test_a_table_that_contradicts_its_recording_is_refused(tmp_path: Path):
    path = tracked(tmp_path / "a.csv", gap=25.0)
    with pytest.raises(UsageError, match=r"line 3: says that the car hit, and in the recording it stays 1\.\d+ m away"):
        recorder().measured(path, PhysicalTrial("walk", {"hit": 1.0}, None, "t.csv, line 3"))
    with pytest.raises(UsageError, match="clearance is said to be 4"):
        recorder().measured(path, PhysicalTrial("walk", {"clearance": 4.0}, None, "t.csv, line 3"))
    with pytest.raises(UsageError, match="'walkk' was not simulated; did you mean 'walk'"):
        recorder().measured(path, PhysicalTrial("walkk"))


def test_a_touch_within_noise_is_what_the_table_says_and_named(tmp_path: Path):
    """The road user has nearly left the car's strip, and is 0.15 m inside the corner at the most."""
    edge = SCENARIO.car.half_width + SCENARIO.adversary.reach
    gap = SPEED * (edge - 0.15 + 3.5) / WALKED  # from which the car comes to the crossing line when they are there
    path = tracked(tmp_path / "a.csv", gap=gap)
    seen = recorder().measured(path, PhysicalTrial("walk"))
    assert seen.values["hit"] == 1.0
    said = recorder().measured(path, PhysicalTrial("walk", {"hit": 0.0}, None, "t.csv, line 3"))
    assert (said.values["hit"], said.values["clearance"], said.seen_hit) == (0.0, 0.0, True)
    missed = recorder().measured(tracked(tmp_path / "b.csv", gap=25.0), PhysicalTrial("walk", {"hit": 0.0}))
    assert missed.seen_hit is False
    (line,) = overruled([missed, said])
    assert line.startswith("in 1 of 2 trials the car hits in the recording and not in the table")
    assert not overruled([missed, seen])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("phi,clearence\na,1\n", "unknown column 'clearence'; did you mean 'clearance'"),
        ("clearance\n1\n", "no column 'phi'"),
        ("phi,clearance\n", "has no trial"),
        ("phi,clearance\na,1300\n", "line 2: clearance must be from 0 to 100 m, got 1300: is it in m"),
        ("phi,hit\na,0.5\n", "1 .the car hit. or 0"),
        ("phi,clearance,hit\na,1,1\n", "the car hit, and its clearance is 1 m"),
        ("phi,clearance\na,\n", "neither a file nor a figure"),
        ("phi,clearance,gap\na,1,5000\n", "gap must be"),
        ("phi,file\na,b\n", "SIMULATED must be the folder of an assessment"),
    ],
)
def test_tables_of_trials_that_are_none(tmp_path: Path, text, says):
    path = tmp_path / "trials.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=says):
        read_trials(table_in(tmp_path))


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fusion") / "simulated"
    sizes = "--safe-count 14 --kamikaze-count 2 --collision-runs 140 --simulations 20 --margin-limit 0 --workers 1"
    assert run_skd("assess", *sizes.split(), "--out", folder, "--quiet") == 0
    return folder


@pytest.fixture(scope="module")
def trials(simulated: Path) -> Path:
    """Bags of the example, two kinds of messages in a frame of their own."""
    out = simulated.parent / "trials"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(EXAMPLE), str(simulated), str(out)])
        runpy.run_path(str(EXAMPLE), run_name="__main__")
    return out


NAMES = ("--car", "/car/odometry", "--road-user", "/dummy/pose", "--frame", "420,-35,30")


def test_bags_become_sentences(simulated: Path, trials: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run_skd("fuse", simulated, trials, *NAMES, "--gap-tolerance", "1", "--out", tmp_path / "fused") == 0
    said = capsys.readouterr().out
    content = json.loads((tmp_path / "fused" / "fusion.json").read_text("utf-8"))
    assert set(content["figures"]) == {"clearance", "required_deceleration", "hit"}
    for sentence in content["sentences"]:
        assert sentence in said
    clearance = content["figures"]["clearance"]
    assert clearance["trials"] == clearance["phi"] == 12
    assert clearance["simulated_phi"] == 14
    # The episodes that were recorded say what the figure of each trial has to be.
    example = runpy.run_path(str(EXAMPLE))
    measured = {one["phi"]: one["physical"] for one in clearance["gap"]["by_phi"]}
    played = _played(example, simulated)
    assert [measured[name] for name in played] == pytest.approx(list(played.values()), abs=0.05)


def test_trials_calibrate_the_simulator(simulated: Path, trials: Path, tmp_path: Path, capsys):
    """The example's car brakes 0.15 s late; what it was played with is in the interval."""
    out = tmp_path / "calibrated"
    words = ("--parameters", "delay", "--workers", "1")
    assert run_skd("fuse", "--calibrate", simulated, trials, *NAMES, *words, "--out", out) == 0
    content = json.loads((out / "simulator.json").read_text("utf-8"))
    delay = content["parameters"]["delay"]
    assert delay["ci95"][0] < 0.15 < delay["ci95"][1]
    assert delay["ci95"][1] - delay["ci95"][0] < 0.1
    assert content["parameters"]["friction"]["reason"] == "not requested"
    scenario = load_scenario(str(out / "simulator.yaml"))
    assert scenario.car.brake_delay == delay["value"]
    assert scenario.car.dynamics == "multi_body"
    assert content["sentences"][0] in capsys.readouterr().out


def _played(example: dict[str, Any], simulated: Path) -> dict[str, float]:
    result, found = load_result(simulated), {}
    figures = json.loads((simulated / "assessment.json").read_text("utf-8"))
    data = figures["scenario"]
    ground = {**data["car"], **example["ON_THE_GROUND"]}
    scenario = scenario_from_dict({**data, "car": ground, "road": {**data["road"], "friction": 0.8}})
    plan = Plan(scenario=scenario, seed=2024, multiplier=figures["multiplier"], safe_count=12)
    for number in np.random.default_rng(1).choice(len(result.safe), 12, replace=False).tolist():
        phi = Trajectory(result.safe[number], plan.scenario.time_step, f"synthetic/{number}")
        log = run_episode(plan.episode(Mode.REPLAY, number, 0, phi))
        times = np.arange(len(log.car)) * plan.scenario.time_step
        if np.isnan(log.impact_time):
            found[phi.name] = least_clearance(scene_of(scenario, times, log.adversary, log.car))
    return found


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--frame", "420,-35,30"), "has no message on /ego/odometry"),
        (NAMES[:4], "off its φ"),
        ((*NAMES[:2], "--road-user", NAMES[1], *NAMES[4:]), "are both '/car/odometry'"),
        ((*NAMES, "--gap-tolerance", "0.000001"), "no run within 1e-06 m"),
        (("--frame", "1,2"), "must be X,Y,DEGREES"),
    ],
)
def test_options_that_do_not_fit_the_bags(simulated, trials, tmp_path, capsys, words, says):
    assert run_skd("fuse", simulated, trials, *words, "--out", tmp_path / "out") == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
