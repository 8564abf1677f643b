"""Another simulator than SKD's own: margin and risk by whole episodes, its own contacts, what it says of the car."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from common import assert_valid
from skd_evaluator import assess
from skd_evaluator.assessment.episode_figures import simulator_contacts
from skd_evaluator.assessment.from_options import check_car
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.report.warnings import contact_warnings
from skd_sim import EpisodeLog, EpisodeSpec, Frame, Mode, Outcome, Trajectory, UsageError, WorldSimulator, load_scenario
from skd_sim.options.car_and_adversary import SIMULATORS
from skd_sim.options.options import options_of

CROSSING = load_scenario("crossing")


class Twin(WorldSimulator):
    """SKD's own world without its noise, as somebody else's simulator that says what its car does."""

    repeats_itself = True
    own_contact = math.nan

    def reset(self, episode: EpisodeSpec) -> Frame:
        car = replace(episode.scenario.car, speed_noise=0.0, acceleration_noise=0.0)
        return super().reset(replace(episode, scenario=replace(episode.scenario, car=car)))

    def described(self, scenario):
        return {"limits": [-9.0, 4.0], "name": scenario.name}


@pytest.fixture
def twin(monkeypatch):
    monkeypatch.setitem(SIMULATORS.own, "twin", f"{__name__}:Twin")


def log(outcome: Outcome, impact: float, own: float | None) -> EpisodeLog:
    phi = Trajectory(np.array([(-2.0, 0.0), (2.0, 0.0)]), CROSSING.time_step)
    episode = EpisodeSpec(CROSSING, Mode.REPLAY, 0, 0, safe_trajectory=phi)
    return EpisodeLog(episode, outcome, np.zeros((2, 2)), np.zeros((2, 4)), impact, 5.0, own_contact=own)


def test_contacts_that_differ_are_counted_and_said():
    hit, passed = Outcome.COLLISION, Outcome.ARRIVED
    logs = [
        log(hit, 1.0, 1.02), log(hit, 1.0, 0.9), log(hit, 1.0, math.nan), log(passed, math.nan, 0.5),
        log(passed, math.nan, math.nan), log(Outcome.ABORTED, math.nan, 0.5),
    ]  # fmt: skip
    found = simulator_contacts(logs)
    counts = [found[name] for name in ("both", "geometry_alone", "simulator_alone", "episodes")]
    assert counts == [2, 1, 1, 5]
    assert found["greatest_gap"] == pytest.approx(0.1)
    (line,) = contact_warnings({"simulator_contacts": found})
    assert "of 5 episodes" in line
    assert simulator_contacts([log(hit, 1.0, None)]) == {}
    assert contact_warnings({}) == []
    agreed = simulator_contacts(logs[:2])
    assert contact_warnings({"simulator_contacts": agreed}) == []


def test_margin_and_risk_by_whole_episodes(twin, tmp_path):
    """In a world without noise what they find is not below the exact margin, and near it; results say whose it is."""
    quiet = replace(CROSSING, car=replace(CROSSING.car, speed_noise=0.0, acceleration_noise=0.0))
    file = tmp_path / "quiet.yaml"
    file.write_text(json.dumps({**quiet.as_dict(), "name": "quiet"}))
    small = {"safe_count": 2, "kamikaze_count": 2, "collision_runs": 4, "simulations": 50, "workers": 1}
    twin = {"scenario": str(file), "simulator": "twin", "objective": "deviation", **small}
    there = assess("basic", out=tmp_path / "there", **twin)
    again = assess("basic", warm_start=str(tmp_path / "there"), behaviour="none", **twin)
    assert again.margins.search.how.endswith(f", from the hits of {tmp_path / 'there'} on; 4 of 4 hits came again")
    driven = [sum(one["candidates"] for one in each.margins.search.sources) for each in (there, again)]
    assert 1.9 * driven[1] < driven[0]
    assert again.margins.mean <= there.margins.mean + 1e-9
    here = assess("basic", scenario=str(file), objective="deviation", behaviour="none", **small)
    found, exact = np.concatenate(there.margins.per_phi), np.concatenate(here.margins.per_phi)
    assert not there.margins.exact
    assert np.all(found >= exact - 1e-6)
    assert found.mean() <= 1.1 * exact.mean()
    result = json.loads(json.dumps(there.as_dict()))
    assert result["simulation"] == {"limits": [-9.0, 4.0], "name": "quiet"}
    assert result["simulator_contacts"]["simulator_alone"] == 0
    assert result["risk"]["scales"][0]["runs"] == 16
    assert_valid(result)
    assert "simulation" not in here.as_dict()


def test_one_that_does_not_say_it_repeats_itself_has_neither(twin, monkeypatch):
    monkeypatch.setattr(Twin, "repeats_itself", False)
    small = {"safe_count": 1, "kamikaze_count": 1, "collision_runs": 1, "simulations": 50, "workers": 1}
    found = assess("basic", simulator="twin", objective="deviation", **small)
    assert (found.margins, found.risks) == (None, None)
    assert "simulator twin" in found.margin_note
    assert "simulator twin" in found.risk_note


@pytest.mark.parametrize(
    ("simulator", "graph", "instead"),
    [("world", False, "add --simulator metadrive"), ("metadrive", True, "leave out --graph")],
)
def test_a_driver_of_one_simulator_is_refused_elsewhere(simulator, graph, instead):
    values = {one.name: one.unsaid for one in options_of(GraphOptions)}
    values |= {"controller": "metadrive_expert", "multiplier": 1.0, "simulator": simulator}
    with pytest.raises(UsageError, match=f"decides within simulator metadrive: {instead}"):
        check_car(values, CROSSING, graph=graph)
