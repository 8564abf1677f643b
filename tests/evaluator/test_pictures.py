"""Pictures are written for every kind of assessment, in a size that a page can show."""

import dataclasses
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import imread
from skd_evaluator import Assessment, Plan, palette
from skd_evaluator.assessment.assessment import KamikazeSet, ObjectiveResult
from skd_evaluator.assessment.run.episodes import aborted
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.margins import Margins
from skd_evaluator.report.charts import save_sweep
from skd_evaluator.report.pictures import save_trajectories
from skd_sim import EpisodeLog, EpisodeSpec, Mode, Outcome, Trajectory, load_scenario

CROSSING = load_scenario("crossing")
pytestmark = pytest.mark.usefixtures("pictures_drawn")


def assessment(counts: list[int], *, north: float = 0.0, name: str = "φ") -> ObjectiveResult:
    """Return one with `counts[k]` kamikaze trajectories for φ number k."""
    rng = np.random.default_rng(0)
    x = np.arange(-3.5, 3.0, 0.75)
    safe = [
        Trajectory(np.column_stack([x, np.linspace(0.1 * k, north, len(x))]), CROSSING.time_step, f"{name}{k}")
        for k in range(len(counts))
    ]
    sets = []
    for k, (phi, count) in enumerate(zip(safe, counts, strict=True)):
        logs = []
        for i in range(2 * count + 1):
            episode = EpisodeSpec(CROSSING, Mode.KAMIKAZE, 0, 1000 * k + i, safe_trajectory=phi)
            if i < count:
                walked = phi.positions[:6] + np.cumsum(rng.normal(0.0, 0.2, (6, 2)), axis=0)
                car = np.column_stack([np.zeros(6), np.linspace(-16.0, -2.5, 6), np.full((6, 2), (np.pi / 2, 8.0))])
                logs.append(EpisodeLog(episode, Outcome.COLLISION, walked, car, 1.4, 5.0))
            else:
                logs.append(EpisodeLog(episode, Outcome.TIMEOUT, phi.positions[:6], np.zeros((6, 4))))
        sets.append(KamikazeSet(phi, tuple(logs)))
    return ObjectiveResult(Plan(CROSSING, safe_count=len(counts)), tuple(sets))


def whole(what: ObjectiveResult, **more: Any) -> Assessment:
    return Assessment(what.plan, tuple(one.safe_trajectory for one in what.kamikaze), (what,), **more)


def draw(path: Path, what: ObjectiveResult) -> None:
    save_trajectories(path, whole(what), what)


@pytest.fixture(autouse=True)
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def drawn(path) -> np.ndarray:
    """Return the pixels; fails on a file that is no PNG, and on one without a picture in it."""
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    pixels = imread(path)
    height, width = pixels.shape[:2]
    assert 600 <= width <= 2400
    assert 300 <= height <= 3200
    colours = np.unique((255 * pixels[::3, ::3, :3]).astype(int).reshape(-1, 3), axis=0)
    assert len(colours) > 10
    return pixels


@pytest.mark.parametrize(
    "counts", [[3], [0], [0, 3, 1], [2] * 9, [60, 50]], ids=["one", "none", "first-empty", "more-than-six", "many"]
)
def test_trajectories(tmp_path, counts):
    draw(tmp_path / "picture.png", assessment(counts))
    drawn(tmp_path / "picture.png")


def row(kind: str, multiplier: float, skd: float | None) -> dict[str, object]:
    keys = ("margin", "margin_ci95", "deviation", "deviation_ci95_trials", "skd", "skd_ci95_pairs", "contact_rate")
    values = [None] * 7 if skd is None else [0.2 * skd, (0.2 * skd - 0.1, 0.2 * skd + 0.2), 0.3 * skd, None, skd,
              (skd - 0.1, skd + 0.1), 0.5]  # fmt: skip
    return {"kind": kind, "multiplier": multiplier, **dict(zip(keys, values, strict=True))}


@pytest.mark.parametrize(
    "rows",
    [
        [row(kind, c, 3.0 + c) for kind in ("synthetic", "recorded") for c in (0.5, 1.0, 1.15)],
        [row("synthetic", 0.5, None), {**row("synthetic", 1.0, 3.0), "skd_ci95_pairs": None}],
    ],
    ids=["both", "a-gap"],
)
def test_sweep(tmp_path, rows):
    save_sweep(tmp_path / "sweep.png", rows)
    drawn(tmp_path / "sweep.png")


@pytest.fixture
def figures(monkeypatch) -> list[Figure]:
    saved: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda self, *args, **kwargs: (saved.append(self), save(self, *args, **kwargs))[1]
    )
    return saved


def lines(axes: Axes, colour: str) -> list[np.ndarray]:
    """Return what is drawn in a colour as a line, each n × 2: alone, or as one of a collection."""
    groups = [one for one in axes.collections if isinstance(one, LineCollection)]
    alone = [line for line in axes.lines if line.get_linestyle() != "None" and len(line.get_xdata()) > 1]
    return [np.column_stack(line.get_data()) for line in alone if to_hex(line.get_color()) == colour] + [
        segment for group in groups if to_hex(group.get_color()[0]) == colour for segment in group.get_segments()
    ]


def marks(axes: Axes, colour: str) -> np.ndarray:
    """Return where a colour's marks without a line stand, n × 2."""
    (found,) = [one for one in axes.lines if one.get_linestyle() == "None" and to_hex(one.get_color()) == colour]
    return np.column_stack(found.get_data())


def with_margins(what: ObjectiveResult) -> Assessment:
    """A rating whose trials have a way each, but the last of each φ, in which nobody can be hit."""
    ways = []
    for number, group in enumerate(what.kamikaze):
        phi = group.safe_trajectory
        away = [0.2 + 0.1 * k for k in range(2 + number)]
        walked = [Trajectory(phi.positions[:5] + np.array([0.0, one]), phi.time_step) for one in away]
        ways.append((*(Hit(one, way, 4.0, 3.0, 0.0) for one, way in zip(away, walked, strict=True)), None))
    return whole(what, margins=Margins(tuple(ways), CROSSING.eta_max))


def test_the_ways_of_the_margin_are_drawn_beside_those_that_were_planned(tmp_path, figures):
    what = assessment([3, 2])
    rating = with_margins(what)
    save_trajectories(tmp_path / "picture.png", rating, what)
    panels = [axes for axes in figures[0].axes if lines(axes, palette.SAFE.lower())]
    for number, axes in enumerate(panels):
        group = what.kamikaze[number]
        for line, log in zip(lines(axes, palette.KAMIKAZE.lower()), group.logs, strict=True):
            np.testing.assert_array_equal(line, log.trajectory.positions)
        np.testing.assert_array_equal(lines(axes, palette.SAFE.lower()), [group.safe_trajectory.positions])
        ways = [way.trajectory.positions for way in rating.margins.hits[number] if way is not None]
        drawn_lines = lines(axes, palette.MARGIN.lower())
        assert len(drawn_lines) == len(ways) == 2 + number
        for line, way in zip(drawn_lines, ways, strict=True):
            np.testing.assert_array_equal(line, way)
        np.testing.assert_array_equal(marks(axes, palette.MARGIN.lower()), [way[-1] for way in ways])
        counts = [0.2 + 0.1 * k for k in range(2 + number)]
        margin = (sum(counts) + CROSSING.eta_max) / (len(counts) + 1)
        assert f"margin {margin:.3f} m, planned" in axes.get_title()
    assert f"margin {rating.margins.mean:.3f} m" in figures[0].get_suptitle()


def test_aborted_episodes_do_not_look_like_safe_ones(tmp_path, figures):
    fine = assessment([0, 2])
    plan, phi = fine.plan, fine.kamikaze[0].safe_trajectory
    silent = [aborted(plan.episode(Mode.KAMIKAZE, 0, n, phi), "no answer: nobody") for n in range(4)]
    lost = dataclasses.replace(fine.kamikaze[0], episodes=tuple(silent))
    what = dataclasses.replace(fine, kamikaze=(lost, fine.kamikaze[1]))
    draw(tmp_path / "picture.png", what)
    assert figures[0].get_suptitle().startswith("4 of 9 episodes aborted\n")
    panels = [axes for axes in figures[0].axes if lines(axes, palette.SAFE.lower())]
    assert "4 of 4 aborted" in panels[0].get_title()
    draw(tmp_path / "fine.png", fine)
    assert "aborted" not in figures[1].get_suptitle() + "".join(axes.get_title() for axes in figures[1].axes)
