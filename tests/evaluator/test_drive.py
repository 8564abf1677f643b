"""`skd drive` in process: what keys do, what is drawn, and that an episode is what it is without anybody watching."""

import math
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from cli_support import CROSSING, one_line
from skd_evaluator import Plan, run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories, single_episode
from skd_evaluator.driving.drive import (
    Controls,
    Hand,
    LeftError,
    Onlooker,
    Situation,
    Wish,
    driving_in_process,
    top_view,
)
from skd_sim import AdversaryState, CarState, EpisodeSpec, Mode, load_scenario
from terminals import Terminal

SCENARIO = load_scenario("crossing")
NORTH = 0.5 * math.pi


def of_keys(**changes: float) -> EpisodeSpec:
    return Plan(replace(SCENARIO, **changes)).episode(Mode.SAFE, 0, 0, None)


def test_a_hand_goes_where_the_last_key_pointed_until_it_stands():
    hand, speed = Hand(SCENARIO), SCENARIO.adversary.speed
    assert hand.act(CarState(0, 0, 0, 0)) == (0.0, 0.0)
    hand.press("down")
    assert hand.act(CarState(0, 0, 0, 0)) == hand.act(CarState(0, 0, 0, 0)) == (speed, 0.0)
    hand.press("-")
    hand.press("a")
    assert hand.act(CarState(0, 0, 0, 0)) == (0.0, -0.75 * speed)
    for _ in range(9):
        hand.press("-")
    assert hand.act(CarState(0, 0, 0, 0)) == (0.0, -0.25 * speed)
    hand.press(" ")
    assert hand.act(CarState(0, 0, 0, 0)) == (0.0, 0.0)


def test_the_world_goes_as_the_keys_say():
    """Straight across at 2.5 m/s: place after k ticks in closed form."""
    controls, seen = Controls(), []
    controls.hand = Hand(SCENARIO)
    controls.press("down")
    episode = of_keys()
    log = driving_in_process(episode.car, 1e6, lambda _episode: controls.hand, seen.append, controls.look)(episode)
    adversary = SCENARIO.adversary
    ticks = np.arange(len(log.adversary))
    expected = np.column_stack([adversary.start_x + 0.3 * adversary.speed * ticks, np.full(len(ticks), 0.0)])
    assert np.allclose(log.adversary, expected)
    assert [one.time for one in seen] == pytest.approx((0.3 * ticks).tolist())
    assert [one.car.y for one in seen] == log.car[:, 1].tolist()


def test_an_episode_that_is_watched_is_the_same(tmp_path):
    (tmp_path / "across.csv").write_text(CROSSING)
    plan = Plan(SCENARIO, safe=str(tmp_path / "across.csv"), safe_count=1)
    episode = single_episode(plan, Mode.REPLAY, 0, safe_trajectories(plan, InProcessRunner(1))[0])
    seen: list[Situation] = []
    log = driving_in_process(episode.car, 1e6, lambda _episode: None, seen.append, lambda: Wish.NONE)(episode)
    alone = run_episode(episode)
    assert (log.outcome, log.impact_time) == (alone.outcome, alone.impact_time) or math.isnan(alone.impact_time)
    assert log.car.tobytes() == alone.car.tobytes()
    assert log.adversary.tobytes() == alone.adversary.tobytes()
    assert max(one.strayed for one in seen) == pytest.approx(0.0, abs=1e-9)


def test_who_has_seen_enough_leaves():
    controls = Controls()
    controls.press("r")
    episode = of_keys()
    drive = driving_in_process(episode.car, 1e6, lambda _one: Hand(SCENARIO), lambda _s: None, controls.look)
    with pytest.raises(LeftError):
        drive(episode)
    assert controls.take() is Wish.AGAIN
    assert controls.look() is Wish.NONE
    controls.press("q")
    controls.press("r")
    assert controls.take() is controls.take() is Wish.QUIT  # which nothing takes back


def situation(car: CarState, adversary: AdversaryState) -> Situation:
    return Onlooker(of_keys()).see(0, 0, car, adversary, -3.5, 0.01)


@pytest.mark.parametrize(
    ("command", "said"),
    [((-3.5, 0.1), "steering 5.7° to the left"), ((0.0, -0.1), "steering 5.7° to the right"), ((1.0, 0.0), "")],
)
def test_the_steering_angle_is_shown_of_a_car_that_steers(command: tuple[float, float], said: str) -> None:
    car, adversary = CarState(0.0, -10.0, NORTH, 8.0), AdversaryState(-3.5, 0.0, 0.0, 0.0)
    line = Onlooker(of_keys()).see(0, 0, car, adversary, command, 0.01).line()
    assert f"command {command[0]:+.1f} m/s²" in line
    assert ("steering" in line) == bool(said)
    assert said in line


def test_the_picture_is_to_scale():
    """Half a metre to a half of a letter, each way: the car's area in halves, and the columns between both."""
    car, adversary = CarState(0.0, -10.0, NORTH, 8.0), AdversaryState(-3.5, 0.0, 0.0, 0.0)
    lines = top_view(situation(car, adversary), 80, 18).plain.splitlines()
    drawn = "".join(lines)
    halves = 2 * drawn.count("█") + drawn.count("▀") + drawn.count("▄")
    assert 9 * 3 <= halves <= 10 * 4  # 4.5 by 1.8 m: 9 by 3.6 halves
    assert [len(line) for line in lines] == [80] * 18
    (row,) = (number for number, line in enumerate(lines) if "●" in line)
    body = [number for number, line in enumerate(lines) if "█" in line]
    assert body[0] - row in (2, 3)  # from x = −3.5 m to −0.9 m, a letter's height is 1 m
    front = max(line.rfind("█") for line in lines)
    assert lines[row].index("●") - front == pytest.approx((10.0 - 2.25) / 0.5, abs=1)
    moved = top_view(situation(CarState(0.0, -10.0, 0.0, 8.0), adversary), 80, 18).plain
    assert max(line.count("█") for line in moved.splitlines()) <= 4  # it points down: 1.8 m wide


def test_without_a_terminal_it_says_what_it_needs(skd_here, here):
    one_line(skd_here("drive"), 2, "keys of a terminal", "--safe synthetic", "--ticks N")
    one_line(skd_here("drive", "--controller", "nope"), 2, "unknown controller 'nope'")
    done = skd_here("drive", "--ticks", "4", "-p", "rate_factor:=100")
    assert done.returncode == 0
    said = [line.partition(",")[0] for line in done.stdout.splitlines()]
    assert said == ["time 0.0 s", "time 1.2 s", "no collision until the time limit; 4 ticks"]
    one_line(skd_here("drive", "--safe", "good.csv", "--safe-number", "1"), 2, "--safe-number 1", "1 safe")
    one_line(skd_here("drive", "--ticks", "1", "--safe-number", "1"), 2, "--safe-number 1", "add --safe")
    one_line(skd_here("drive", "--ticks", "1", "--controller", "external"), 2, "add --graph")
    one_line(skd_here("drive", "--ticks", "1", "-p", "command_type:=twist"), 2, "goes with --controller external")


def test_on_a_terminal_one_walks_by_keys(here):
    terminal = Terminal([sys.executable, "-m", "skd_evaluator", "drive", "--multiplier", "0.5"], PYTHONPATH=str(here))
    terminal.wait_for("press a key to begin")
    assert "clearance" not in terminal.text  # it waits
    terminal.press(" ")
    terminal.wait_for("clearance 1")  # it has begun
    assert "arrows or w a s d: walk" in terminal.text
    terminal.press("\x1b[B")
    ended = terminal.wait_for(r"(collision|arrived).* r: again").group(0)
    terminal.press("r")
    terminal.wait_for(r"time 0\.")
    terminal.press("q")
    assert terminal.finish() == 0
    last = terminal.text.rstrip().splitlines()[-1].strip()
    assert last in ended  # what has ended is said again, where it stays
    assert re.fullmatch(r"(collision after [\d.]+ s at [\d.]+ m/s|arrived); \d+ ticks", last)


def test_the_terminal_is_given_back_when_it_is_left(here):
    """Below a shell, as a user has it: Ctrl-Z does nothing, and after Ctrl-C the shell shows what is typed."""
    shell = Terminal(["/bin/bash", "--norc", "--noprofile", "-i"], PYTHONPATH=str(here), PS1="> ")
    shell.press(f"{sys.executable} -m skd_evaluator drive\r")
    shell.wait_for("press a key to begin")
    shell.press(" ")
    shell.wait_for("clearance 1")
    shell.press("\x1a\x1c+")  # and a key, without the enter key
    shell.wait_for(r"time \d")
    assert drawn_on(shell) == 1
    shell.press("\x03")
    shell.wait_for("interrupted; nothing was written")
    shell.press("stty -a | tr ' ' '\\n' | grep -x -e -*icanon\r")
    assert not shell.wait_for("-?icanon\r").group(0).startswith("-")
    assert drawn_on(shell) == 0
    shell.press("exit\r")
    assert shell.finish() == 0


def drawn_on(terminal: Terminal) -> int:
    """How often the other screen was entered and not left; the cursor is hidden on it and nowhere else."""
    found = terminal.count("\x1b[?1049h") - terminal.count("\x1b[?1049l")
    hidden = terminal.count("\x1b[?25l") - terminal.count("\x1b[?25h")
    assert (found > 0) == (hidden > 0)
    return found
