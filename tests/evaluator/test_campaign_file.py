"""The file of a campaign: what it comes to, and that a mistake is one line that says where it is."""

import re
from pathlib import Path

import pytest
import yaml
from cli_support import CROSSING
from common import refused
from skd_evaluator.assessment.plan import TRIALS_PER_REQUESTED
from skd_evaluator.extensions.campaign.cells import make_cells, read_campaign
from skd_sim import load_scenario
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES, Objective

ROOT = Path(__file__).resolve().parents[2]


def read(folder: Path, text: str):
    (folder / "campaign.yaml").write_text(text)
    return read_campaign(folder / "campaign.yaml")


def test_everything_is_crossed_in_the_order_of_the_file(tmp_path):
    cells = read(
        tmp_path,
        """
        defaults: {safe_count: 2, maximum_distance: 3}
        cars:
          - {controller: basic, sweep: {multiplier: [1, 0.75]}}
          - {name: the other, controller: cal, safe_count: 3}
        scenarios:
          - scenario: crossing
          - {scenario: crossing, name: slow, scenario.car.start_speed: 5.0}
        sweep:
          seed: [4, 2]
        """,
    )
    assert [cell.name for cell in cells] == [
        f"{car}_{scenario}_seed={seed}"
        for car in ("basic-C1", "basic-C0.75", "the-other")
        for scenario in ("crossing", "slow")
        for seed in (4, 2)
    ]
    keys = ("controller", "multiplier", "safe_count", "maximum_distance", "seed")
    values = [tuple(cell.values[key] for key in keys) for cell in cells]
    assert values[:2] == [("basic", 1.0, 2, 3.0, 4), ("basic", 1.0, 2, 3.0, 2)]
    assert values[4] == ("basic", 0.75, 2, 3.0, 4)
    assert values[-1] == ("cal", 1.0, 3, 3.0, 2)
    assert isinstance(values[0][1], float)
    assert [dict(cell.changes) for cell in cells[:3]] == [{}, {}, {"car.start_speed": 5.0}]
    assert cells[4].swept == {"multiplier": 0.75, "seed": 4}


def test_any_key_of_a_scenario_can_be_swept(tmp_path):
    text = """
        cars: [{controller: basic}, {controller: carla}]
        sweep:
          scenario: [crossing, crossing_multi_body]
          scenario.adversary.distance_noise: [0.5, 2]
    """
    cells = make_cells(read(tmp_path, text))
    assert [cell.plan.scenario.adversary.distance_noise for cell in cells] == [0.5, 2.0] * 4
    assert [cell.plan.scenario.car.dynamics for cell in cells] == ["basic", "basic", "multi_body", "multi_body"] * 2
    assert cells[0].name == "basic-C1_scenario=crossing_distance_noise=0.5"
    plain = load_scenario("crossing").as_dict()
    plain["adversary"]["distance_noise"] = 0.5
    assert cells[0].plan.scenario.as_dict() == plain
    assert len({cell.key for cell in cells}) == len(cells)


def test_paths_are_those_beside_the_file(tmp_path, monkeypatch):
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "walk.csv").write_text(CROSSING)
    (tmp_path / "deep" / "mine.yaml").write_text(yaml.safe_dump(load_scenario("crossing").as_dict()))
    text = "defaults: {safe: walk.csv, safe_count: 1, scenario: mine.yaml}"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deep" / "campaign.yaml").write_text(text)
    (cell,) = make_cells(read_campaign(Path("deep/campaign.yaml")))
    assert cell.plan.safe == "deep/walk.csv"
    assert cell.plan.scenario.name == "crossing"


def test_how_many_episodes_there_are(tmp_path):
    text = "defaults: {safe_count: 3, kamikaze_count: 7, collision_runs: 11}\nsweep: {objective: [both, paper]}"
    both, paper = make_cells(read(tmp_path, text))
    assert [cell.requested["objectives"] for cell in (both, paper)] == [DEFAULT_OBJECTIVES, (Objective.PAPER,)]
    assert both.episodes() == 3 + 2 * 3 * 7 + 11
    assert paper.episodes() == 3 + 3 * 7 + 11
    assert paper.episodes(TRIALS_PER_REQUESTED) == 3 + TRIALS_PER_REQUESTED * 3 * 7 + 11


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("a: [1", ["not valid YAML"]),
        ("cars: {controller: cal}", ["cars must be a list of at least 1, got dict"]),
        ("cars: [{}, {controler: cal}]", ["unknown key cars[1].controler", "did you mean 'controller'?"]),
        ("cars: [{multiplier: 1000}]", ["cars[0].multiplier must be a number from 0 to 100, got 1000"]),
        ("defaults: {name: all}", ["unknown key defaults.name"]),
        ("sweep: {seed: 3}", ["sweep.seed must be a list of at least 1, got int"]),
        ("sweep: {seed: [1, 2, 1]}", ["sweep.seed: a value is given twice"]),
        ("cars: [{seed: 3}]\nsweep: {seed: [1]}", ["seed is set in cars and in sweep"]),
        ("cars: [{seed: 3, sweep: {seed: [1]}}]", ["seed is set in cars[0] and in cars[0].sweep"]),
        ("cars: [{}, {seed: 1}]", ["two cells are called basic-C1", "name:"]),
        (
            "sweep: {seed: [%s], simulations: [%s]}" % ((", ".join(map(str, range(1, 200))),) * 2),
            ["sweep: more than 10000 combinations"],
        ),
        ("sweep: {scenario.car.start_sped: [1.0]}", ["cars[0]", "unknown key car.start_sped", "'start_speed'?"]),
        ("sweep: {scenario.car.start_speed: [900]}", ["car.start_speed must be a number from 0 to 60", "900"]),
        ("defaults: {scenario: crosing}", ["defaults.scenario", "'crosing'", "did you mean 'crossing'?"]),
        ("cars: [{controller: nobody}]", ["cars[0]:", "unknown controller 'nobody'"]),
        ("cars: [{controller: external}]", ["cars[0]:", "needs the node graph"]),
        ("cars: [{graph: true, curve: true}]", ["cars[0]:", "curve"]),
    ],
)
def test_a_mistake_is_one_line_that_says_where(tmp_path, text, parts):
    with refused(tmp_path / "campaign.yaml", *parts):
        make_cells(read(tmp_path, text))


@pytest.mark.parametrize("name", ["sweep", "versions"])
def test_the_examples_are_campaigns(name):
    cells = make_cells(read_campaign(ROOT / "examples" / "campaign" / f"{name}.yaml"))
    assert len(cells) == {"sweep": 24, "versions": 6}[name]


def test_the_file_in_the_documentation_is_a_campaign(tmp_path):
    page = (ROOT / "docs" / "campaigns.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert "12 *cells*" in page
    assert len(read(tmp_path, block)) == 12
