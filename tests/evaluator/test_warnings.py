"""What a reader should know before believing the figures is said; names are shown as they are."""

from dataclasses import replace

import pytest
from comparison_support import FIGURES
from rich.console import Console
from skd_evaluator import Assessment, Plan
from skd_evaluator.margin.search.search import HELD_COMMANDS, IN_PROCESS, WHOLE_EPISODES, Effort
from skd_evaluator.report.formats import gap_basis
from skd_evaluator.report.terminal import details_table, headline, headline_table, safe_trajectory_table
from skd_evaluator.report.warnings import figure_warnings
from skd_sim import Mode, Outcome, load_scenario
from stages import rate
from test_campaign import StubRunner, straight, trial

CROSSING = load_scenario("crossing")
PLAN = Plan(CROSSING, safe_count=2, kamikaze_count=5, collision_runs=40, simulations=1)


def assessed(decide, plan: Plan = PLAN, runner: type[StubRunner] = StubRunner) -> Assessment:
    """An assessment of two φ whose episodes end as `decide` says."""
    return rate(plan, [plan.objective], [straight(name="one"), straight(1.0, "two")], runner(decide))


def shown(rating: Assessment) -> str:
    console = Console(width=150, record=True)
    console.print(headline_table(rating.as_dict()))
    console.print(details_table(rating.as_dict()))
    console.print(safe_trajectory_table(rating.as_dict()))
    return console.export_text()


def test_safe_trajectory_that_is_always_hit_is_named():
    def decide(episode):
        second = episode.safe_trajectory.name == "two"
        return Outcome.COLLISION if second or episode.mode == Mode.KAMIKAZE else Outcome.ARRIVED

    found = assessed(decide)
    (line,) = figure_warnings(found.as_dict())
    assert "not safe with this car: 1 of 2 safe trajectories, e.g. two: 100 % of the runs" in line
    rows = found.as_dict()["per_safe_trajectory"]
    names = ("contact_rate", "collision_runs", "safe")
    assert [tuple(map(row.get, names)) for row in rows] == [(0.0, 20, True), (1.0, 20, False)]
    assert "100.0 %, not safe" in shown(found)
    assert figure_warnings(assessed(decide, replace(PLAN, collision_runs=8)).as_dict()) == []  # too few runs to say so


def test_clipped_commands_are_counted_wherever_they_were():
    class Clipping(StubRunner):
        def run(self, episodes):
            for log in super().run(episodes):
                number, along = trial(log.episode), log.episode.mode == Mode.REPLAY
                yield replace(log, clipped=2 * (number == 3) if along else 5 * (number == 0))

    found = assessed(lambda episode: Outcome.COLLISION if trial(episode) % 2 else Outcome.MISSED, runner=Clipping)
    assert found.as_dict()["commands_clipped"] == {"commands": 14, "episodes": 4}
    (line,) = figure_warnings(found.as_dict())
    assert "14 commands in 4 episodes" in line


RESULT = {
    **FIGURES,
    "car": "a.b:C",
    "margin": 5.0,
    "margin_ci95": (5.0, 5.0),
    "margin_budget": 128,
    "margin_trials": 12,
    "margin_beyond": 12,
    "per_safe_trajectory": [{"safe": True}] * 3,
    "distinct_safe_trajectories": 3,
    "optimality_gap": None,
    "impact_speed": None,
    "skd": 1.0,
    "objectives": {},
    "collision_runs": 24,
    "until_width": None,
    "commands_clipped": {"commands": 0, "episodes": 0},
}


@pytest.mark.parametrize(
    ("p90", "hit_speed", "trials", "said"),
    [
        (0.7, 0.556, 12, True),
        (0.9, 0.556, 12, False),
        (0.7, 0.556, 11, False),
        (0.1, 0.0, 12, False),
        (None, 0.5, 12, False),
    ],
)
def test_a_car_that_is_judged_by_slow_touches_is_named(p90, hit_speed, trials, said):
    impact = None if p90 is None else {"mean": 0.6, "p90": p90}
    margin = {"margin": 1.0, "margin_ci95": (0.9, 1.1), "margin_trials": trials, "margin_beyond": 2}
    scenario = {"collision": {"hit_speed": hit_speed}}
    found = figure_warnings({**RESULT, **margin, "impact_speed": impact, "scenario": scenario})
    assert len(found) == said
    assert not said or "at 0.70 m/s or less, and a hit begins at 0.556 m/s" in found[0]


def planned(hits: int, standing: int, *, deviation: bool) -> dict[str, object]:
    """Kamikazes of one objective: 20 trials, so many hits by the moving car, so many that walked into it."""
    reached = hits if deviation else hits + standing
    return {"trials": 20, "failed": 20 - reached, "standing_contacts": standing, "plans_deviation": deviation}


@pytest.mark.parametrize("deviation", [True, False])
@pytest.mark.parametrize(
    ("beyond", "along", "hits", "standing", "said"),
    [
        (12, 3, 0, 0, "but 3 other episodes ended in a hit"),
        (12, 2, 1, 4, "but 3 other episodes ended in a hit"),
        (12, 0, 0, 4, "only walked into: 4 kamikazes touched it"),
        (12, 0, 0, 0, "12 trials have the same margin"),
        (11, 3, 0, 0, ""),
    ],
)
def test_hits_that_the_margins_own_trials_do_not_have_are_said(beyond, along, hits, standing, said, deviation):
    ends = {"margin_ci95": (5.0, 5.0) if beyond == 12 else (4.2, 5.0), "nominal_collision_rate": along / 24}
    objectives = {"one": planned(hits, standing, deviation=deviation)}
    result = {**RESULT, **ends, "margin_beyond": beyond, "objectives": objectives}
    found = figure_warnings(result)
    assert said in " ".join(found)
    assert bool(found) == bool(said)
    collide = f"But {100 * along / 24:.1f} % of the runs along nominal trajectories collide."
    assert (collide in headline(result)) == (beyond == 12 and along > 0)


def test_a_margin_of_nothing_needs_no_more_trials() -> None:
    on_phi = {**RESULT, "margin": 0.0, "margin_ci95": (0.0, 0.0), "margin_beyond": 0}
    assert figure_warnings(on_phi) == ["in all 12 trials the car hits on φ itself"]


@pytest.mark.parametrize(
    ("how", "effort"), [("", IN_PROCESS), ("whole episodes", WHOLE_EPISODES), ("episodes of held", HELD_COMMANDS)]
)
def test_a_search_that_has_not_converged_gives_an_upper_bound(how: str, effort: Effort) -> None:
    budget = 1024
    found = {"margin": 2.0, "margin_ci95": (1.5, 2.5), "margin_beyond": 3, "margin_budget": budget}
    result = {**RESULT, **found, "margin_converged": False, "margin_how": f"by up to {budget} {how} commands"}
    said = headline(result)
    assert "Safety margin at most 2.000 m" in said
    assert "No hit found in 3 of 12: each counts as 5 m." in said
    twice = 2 * budget * IN_PROCESS.limit // effort.limit
    assert "had not converged at 1024 candidates a trial (no hit in 3 of 12 trials)" in figure_warnings(result)[0]
    assert figure_warnings(result)[0].endswith(f"give --margin-limit {twice}")
    deep = {**result, "margin_beyond": 0, "margin_excess": {"mean": 0.06}}
    assert "a trial (0.060 m too high, by trials searched deeper)" in figure_warnings(deep)[0]
    converged = {**result, "margin_converged": True}
    assert "at most" not in headline(converged)
    assert "converged" not in headline(converged)
    assert not figure_warnings(converged)


@pytest.mark.parametrize(("model", "left"), [("generic", 0.4), ("generic", None), ("learned", 0.4)])
def test_kamikazes_that_cannot_see_a_car_leave_its_lane_are_told_of(model, left) -> None:
    found = {"optimality_gap": 3.6, "adversary_model": model}
    found |= {} if left is None else {"lane_left": left}  # a car that stays in its lane has none in its result
    line = gap_basis(found)
    assert "judge the car by its margin" in line
    assert ("--adversary-model learned" in line) == (model == "generic" and left is not None)
