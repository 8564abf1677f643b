from pathlib import Path

import numpy as np
import pytest
from common import refused
from skd_adversary.safe_trajectories.sources import load_safe_trajectories, read_csv_trajectory
from skd_sim import UsageError, load_scenario

SCENARIO = load_scenario("crossing")
GOOD = "t,x,y\n0,-3.5,0\n1,-1.0,0.5\n3,2.0,0.5\n"


def _write(folder: Path, text: str, name: str = "walk.csv") -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def test_resampled_linearly(tmp_path: Path) -> None:
    trajectory = read_csv_trajectory(_write(tmp_path, GOOD), SCENARIO)
    t = 0.3 * np.arange(11)
    assert trajectory.time_step == SCENARIO.time_step
    assert trajectory.name == "walk"
    np.testing.assert_allclose(trajectory.positions[:, 0], np.where(t <= 1, -3.5 + 2.5 * t, -2.5 + 1.5 * t))
    np.testing.assert_allclose(trajectory.positions[:, 1], np.minimum(0.5 * t, 0.5))


def test_data_at_the_time_step_come_back_unchanged(tmp_path: Path) -> None:
    # 0.3·k in decimals is rarely 0.3·k in floats; no sample may be lost or moved by that.
    points = np.column_stack([np.linspace(-3.5, 2.0, 30), np.sin(np.arange(30))])
    rows = [f"{1000 + 0.3 * k:.1f},{x!r},{y!r}" for k, (x, y) in enumerate(points.tolist())]
    trajectory = read_csv_trajectory(_write(tmp_path, "\n".join(["t,x,y", *rows])), SCENARIO)
    np.testing.assert_allclose(trajectory.positions, points, atol=1e-9)


@pytest.mark.parametrize(
    "text",
    [
        "\ufefft,x,y\n0,-3.5,0\n3,2,0\n",
        "t,x,y\r\n0,-3.5,0\r\n3,2,0\r\n",
        "t,x,y\n\n0,-3.5,0\n\n3,2,0\n\n",
        "y, note, x, t\n0,a,-3.5,0\n0,,2,3\n",
        't,x,y\n"0","-3.5","0"\n3,2,0',
    ],
    ids=["byte-order mark", "CRLF", "blank lines", "other columns and order", "quotes"],
)
def test_dialects(tmp_path: Path, text: str) -> None:
    trajectory = read_csv_trajectory(_write(tmp_path, text), SCENARIO)
    assert len(trajectory) == 11
    np.testing.assert_allclose(trajectory.positions[[0, -1], 0], [-3.5, 2.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y\n0,-3.5,0\n1,abc,0\n", "line 3: x must be a number, got 'abc'"),
        ("t,x,y\n0,-3.5,0\n\n1,nan,0\n", "line 4: x must be finite, got nan"),
        ("t,x,y\n0,-3.5,1e300\n1,2,0\n", "line 2: y must lie within ±1e+06"),
        ("t,x,y\n0,-3.5,0\n1,0,0\n1,2,0\n", "line 4: t must increase strictly, got 1 after 1"),
        ("t,x,y\n0,-3.5,0\n", "1 points; a track needs at least two points"),
        ("t,x,y\n0,-1.2,0\n0.2,1.15,0\n", "a safe trajectory needs at least two points"),
        ("t,x,y\n0,-3.5,0\n50,2,0\n", "line 3: lasts 50 s, longer than the scenario's horizon of 12 s"),
        ("t,x,y\n0,-3.5,0\n3,-1.5,0\n", "never enters the car's path"),
        ("t,x,y\n0,0,-15\n3,2,0\n", "where the car starts"),
        ("t,x,y\n0,-3,0\n0.3,-2.5,0\n0.6,37.5,0\n", "line 4: moves 40 m in 0.3 s (133 m/s); "),
        ("t,x,y\n0,-3,0\n1,-2,0\n1.3,-2,9\n3,3,0\n", "line 4: moves 9 m"),
        ("t,x,y\n0,-3,0\n1e-310,-2,0\n", "line 3: moves 1 m in 1e-310 s (inf m/s)"),
        ("t,x,y\n0,3,0\n3,-3,0\n", "walks West, from x = 3 to -3 m"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_bad_file(tmp_path: Path, text: str, message: str) -> None:
    file = _write(tmp_path, text)
    with refused(file, message):
        read_csv_trajectory(file, SCENARIO)


def test_sources_file_and_folder(tmp_path: Path) -> None:
    for number, name in enumerate(("b.csv", "a.csv", "c.CSV")):
        _write(tmp_path, GOOD.replace("2.0", f"2.{number}"), name)
    (tmp_path / "notes.txt").write_text("not a trajectory", encoding="utf-8")
    assert [t.name for t in load_safe_trajectories(str(tmp_path), SCENARIO, 3)] == ["a", "b", "c"]
    assert [t.name for t in load_safe_trajectories(str(tmp_path), SCENARIO, 2)] == ["a", "c"]
    assert [t.name for t in load_safe_trajectories(str(tmp_path), SCENARIO, 1)] == ["b"]
    assert [t.name for t in load_safe_trajectories(str(tmp_path / "b.csv"), SCENARIO, 1)] == ["b"]
    with pytest.raises(UsageError, match="3 usable safe trajectories where 5 were requested"):
        load_safe_trajectories(str(tmp_path), SCENARIO, 5)
    _write(tmp_path, "t,x,y\n0,-3.5,0\nx,1,0\n", "d.csv")
    with pytest.raises(UsageError, match=r"d\.csv, line 3: t must be a number"):
        load_safe_trajectories(str(tmp_path), SCENARIO, 2)


def test_what_of_a_folder_is_not_used_is_said(tmp_path, caplog):
    for number, name in enumerate("abcdefg"):
        (tmp_path / f"{name}.csv").write_text(f"t,x,y\n0,-3,0\n3,3,0.{number}\n")
    (tmp_path / "notes.txt").touch()
    taken = load_safe_trajectories(tmp_path, SCENARIO, 5)
    (line,) = caplog.messages
    unused = sorted({*"abcdefg"} - {phi.name for phi in taken})
    assert f"5 of 8 used; not requested: {', '.join(unused)}; no csv file: notes.txt" in line
    caplog.clear()
    (tmp_path / "notes.txt").unlink()
    load_safe_trajectories(tmp_path, SCENARIO, 7)
    assert caplog.messages == []


def test_one_way_in_two_files_of_a_folder_is_no_two_ways(tmp_path):
    for name in "ab":
        (tmp_path / f"{name}.csv").write_text("t,x,y\n0,-3,0\n3,3,0\n")
    with pytest.raises(UsageError, match=r"b\.csv: is the trajectory of .*a\.csv once more"):
        load_safe_trajectories(tmp_path, SCENARIO, 2)
