"""The table of options: what one entry gives, and that what is written is what is read."""

import argparse
import dataclasses
import json
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from skd_evaluator.assessment.from_options import name_of_command, plan_of
from skd_evaluator.assessment.options import CampaignOptions, GraphOptions
from skd_evaluator.cli import arguments as cli
from skd_evaluator.cli.arguments import graph_options
from skd_evaluator.cli.main import make_parser, parse
from skd_sim import EpisodeSpec, Mode, Trajectory, UsageError, load_scenario
from skd_sim.options.car_and_adversary import Objective
from skd_sim.options.options import (
    FIELDS,
    PLANNING,
    EpisodeOptions,
    SimulatorOptions,
    option,
    options_from_text,
    options_of,
)
from skd_sim.ros.from_messages import message_to_episode

CROSSING = load_scenario("crossing")
ACROSS = Trajectory(np.array([(-2.0, 0.0), (2.0, 0.0)]), CROSSING.time_step, "across")


@dataclass(frozen=True, eq=False, kw_only=True)
class More(EpisodeOptions):
    depth: int = option(7, "how deep to look", within=(1, 90), metavar="N", marks=(PLANNING,))
    pace: float | None = option(None, "how fast to go, m/s", float, within=(0.0, 9.0), unset="as it likes")
    bold: bool = option(False, "whether it dares")
    word: str = option("calm", "what it is like")


def message_of(episode: Any) -> SimpleNamespace:
    """What a message of an episode says, by the table."""
    said = {one.name: one.plain(getattr(episode, one.name)) for one in options_of(EpisodeSpec) if one.name in FIELDS}
    points = [SimpleNamespace(x=x, y=y) for x, y in ACROSS.positions.tolist()]
    said |= {"scenario": json.dumps(CROSSING.as_dict()), "public_scenario": "", "mode": 1, "seed": 3, "episode_id": 4}
    safe = {"safe_trajectory_name": "across", "safe_trajectory_time_step": CROSSING.time_step}
    return SimpleNamespace(safe_trajectory=points, options="", **safe, **said)


def test_an_episode_survives_its_message():
    episode = EpisodeSpec(
        CROSSING, Mode.KAMIKAZE, 3, 4, ACROSS, controller="carla", multiplier=0.7, simulations=12,
        objective=Objective.FRECHET, maximum_distance=2.5,
    )  # fmt: skip
    found = message_to_episode(message_of(episode))
    for one in options_of(EpisodeSpec):
        assert getattr(found, one.name) == getattr(episode, one.name), one.name
    plain = message_to_episode(message_of(EpisodeSpec(CROSSING, Mode.KAMIKAZE, 3, 4, ACROSS)))
    assert plain.maximum_distance is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not JSON"),
        ("[1]", "must be a mapping, got list"),
        ('{"height": 3}', "unknown key height; allowed: controller"),
        ('{"particles": -1}', "particles must be a whole number from 0 to 1000000, got -1"),
        ('{"particles": 1.5}', "particles must be a whole number from 0 to 1000000, got 1.5"),
        ('{"particles": true}', "particles must be a whole number from 0 to 1000000, got True"),
        ('{"particles": NaN}', "not JSON that SKD reads: expected value at line 1 column 15"),
        (
            '{"adversary_model": "larned"}',
            "adversary_model must be one of generic, learned, exact, got 'larned'; did you mean",
        ),
        ('{"simulator": 3}', "simulator must be one of world, metadrive"),
        ('{"controller": "cal"}', "controller has a field of its own"),
    ],
)
def test_bad_text_is_one_line(text: str, said: str):
    with pytest.raises(UsageError, match=said) as caught:
        options_from_text(text, "options in /skd/episode")
    assert str(caught.value).startswith("options in /skd/episode: ")
    assert "\n" not in str(caught.value)


def test_the_command_line_is_made_of_the_table(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cli, "options_of", lambda _table: options_of(More))
    parser = cli.Parser(exit_on_error=False)
    parser.set_defaults(command="assess")
    parser.add_options()
    found = vars(parser.parse_args(["--depth", "9", "--bold"]))
    assert (found["depth"], found["bold"], found["pace"], found["word"]) == (9, True, None, "calm")
    for bad in (["--depth", "91"], ["--pace", "0"], ["--pace", "nan"], ["--objective", "fame"]):
        with pytest.raises(argparse.ArgumentError):
            parser.parse_args(bad)
    text = parser.format_help()
    assert "how deep to look (default: 7)" in text
    assert "how fast to go, m/s (default: as it likes)" in text


def test_options_of_a_file_count_less_than_those_of_the_command_line(tmp_path) -> None:
    options = "{seed: 3, safe_count: 7, risk_runs: 40, curve: true}"
    (tmp_path / "car.yaml").write_text(f"/**:\n  ros__parameters: {options}\n")
    words = ["assess", "--params-file", str(tmp_path / "car.yaml"), "--safe-count", "9", "-p", "risk_runs:=50"]
    found = parse(make_parser(), words)
    assert (found.seed, found.safe_count, found.risk_runs, found.curve) == (3, 9, 50, True)


@pytest.mark.parametrize("command", ["assess", "episode", "probe"])
def test_what_is_said_of_the_graph_reaches_it(command: str):
    parser = make_parser()
    assert graph_options(parser.parse_args([command])) == GraphOptions()
    said = ["--pacing", "real_time", "-p", "rate_factor:=20", "-p", "startup_timeout:=7", "--controller-command", "a b"]
    chosen = graph_options(parse(parser, [command, *said]))
    assert chosen == GraphOptions(pacing="real_time", rate_factor=20.0, startup_timeout=7.0, controller_command="a b")
    parameters = chosen.simulator_parameters()
    assert set(parameters) == {one.name for one in options_of(SimulatorOptions)}
    assert (parameters["pacing"], parameters["rate_factor"]) == ("real_time", 20.0)


def test_a_plan_of_parameters_and_one_of_the_command_line_are_the_same():
    parameters = {one.name: one.plain_default for one in options_of(CampaignOptions)}
    parser = make_parser()
    line = vars(parser.parse_args(["assess"]))
    assert plan_of(parameters, CROSSING) == plan_of(line, CROSSING)
    assert plan_of(line, CROSSING).maximum_distance is None
    limited = plan_of({**parameters, "maximum_distance": 2.0, "multiplier": 0.5}, CROSSING, seed=8)
    assert (limited.maximum_distance, limited.multiplier, limited.seed) == (2.0, 0.5, 8)
    assert dataclasses.replace(limited, seed=0).episode(Mode.KAMIKAZE, 0, 0, ACROSS).maximum_distance == 2.0


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("python3 path/to/vendor_controller.py --rate 20", "vendor_controller.py"),
        ("ros2 launch my_stack bringup.launch.py use_sim_time:=true", "my_stack/bringup.launch.py"),
        ("bash -c 'source install/setup.bash && ros2 run pkg node --ros-args -r a:=b'", "pkg/node"),
        ("", ""),
    ],
)
def test_a_stack_is_called_by_what_its_command_starts(command, name):
    assert name_of_command(command) == name
