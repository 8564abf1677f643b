"""`skd report --format png`: one episode as a picture or a film, drawn where it happened."""

import json
import shutil

import numpy as np
import pytest
from cli_support import names, one_line
from common import run_skd
from matplotlib.image import imread
from PIL import Image
from report_support import edited
from shapely import Point, Polygon
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.cli.show import shown_episode
from skd_evaluator.metrics.aborted import NOT_CREDIBLE
from skd_evaluator.report.html.subjects import read_subjects
from skd_evaluator.report.pictures import EpisodePicture
from skd_evaluator.report.repeat import files_of, repeat_command
from skd_sim.scenario.scenario import load_scenario, scenario_from_dict
from skd_sim.world.episode import Mode

pytestmark = pytest.mark.usefixtures("pictures_drawn")

DRAW = ("report", "--format", "png")


@pytest.fixture(scope="module")
def result(sweep):
    return sweep / "synthetic" / "C_0.5"


@pytest.fixture(scope="module")
def subject(result):
    (one,) = read_subjects([result])
    return one


def test_the_worst_are_those_with_the_least_deviation(skd_here, here, result, subject):
    done = skd_here(*DRAW, str(result), "--worst", "2", "--objective", "deviation", "--out", "shown", "--json")
    assert done.returncode == 0, done.stderr
    assert names(here / "shown") == ["1.png", "2.png", "manifest.sha256", "show.json"]
    assert all(imread(here / "shown" / name).shape[1] > 500 for name in ("1.png", "2.png"))
    content = json.loads(done.stdout)
    assert content == json.loads((here / "shown" / "show.json").read_text())
    episodes = subject.episodes
    least = np.sort(episodes.deviation[(episodes.objective == "deviation") & episodes.hit])[:2]
    assert [one["deviation"] for one in content["episodes"]] == pytest.approx(least.tolist(), abs=1e-9)
    assert all(f"deviation {one:.2f} m" in said["title"] for one, said in zip(least, content["episodes"], strict=True))


@pytest.mark.parametrize("words", [(*DRAW, "--worst", "1"), ("export", "--format", "csv", "--json")])
def test_of_figures_that_are_not_credible_that_is_said(words, result, tmp_path, capsys):
    doubts = [f"{NOT_CREDIBLE}it\ncounts", "harmless"]
    doubtful = edited(result, tmp_path / "doubtful", warnings=doubts, margin_converged=False)
    assert run_skd(*words, doubtful, "--out", tmp_path / "out") == 0
    printed = capsys.readouterr()
    assert ("(margin at most " in printed.out) == (words[0] == "report")
    said = [line for line in printed.err.splitlines() if "it counts" in line or "harmless" in line]
    assert said == [f"skd {words[0]}: warning: {NOT_CREDIBLE}it counts"]


def test_files_that_a_command_needs_and_only_the_result_has_are_told(tmp_path, subject):
    own = {**subject.figures, "scenario": {**subject.figures["scenario"], "name": "mine", "eta_max": 4.5}}
    words = repeat_command(own, Mode.REPLAY, "", int(subject.episodes.episode_id[0]))
    assert files_of(subject.figures, repeat_command(subject.figures, Mode.REPLAY, "", 0)) == {}
    ((name, content),) = files_of(own, words).items()
    assert words[words.index("--scenario") + 1] == name
    write_json(tmp_path / name, content)
    assert load_scenario(str(tmp_path / name)).as_dict() == scenario_from_dict(own["scenario"], "it").as_dict()


def test_films(skd_here, here, result, monkeypatch):
    monkeypatch.setattr("skd_evaluator.report.pictures._RATE", 3)
    assert skd_here("report", str(result), "--format", "gif", "--out", "film").returncode == 0
    with Image.open(here / "film" / "1.gif") as film:
        assert film.n_frames > 5
        first = np.asarray(film.convert("RGB"))
        film.seek(film.n_frames - 1)
        assert (np.asarray(film.convert("RGB")) != first).any()
    if shutil.which("ffmpeg"):
        assert skd_here("report", str(result), "--format", "mp4", "--out", "mp4").returncode == 0
        assert (here / "mp4" / "1.mp4").read_bytes()[4:8] == b"ftyp"
    monkeypatch.setenv("PATH", "")
    one_line(skd_here("report", str(result), "--format", "mp4", "--out", "none"), 2, "ffmpeg", "--format gif")
    assert not (here / "none").exists()


def test_what_is_not_there(skd_here, here, sweep, result):
    one_line(skd_here(*DRAW, str(sweep), "--out", "x"), 2, "2 assessments")
    one_line(skd_here(*DRAW, str(result), "--episode", "7", "--out", "x"), 2, "holds no such episode")
    one_line(skd_here(*DRAW, str(result), "--objective", "frechet", "--out", "x"), 2, "no episode of that kind")
    assert not (here / "x").exists()


def test_at_its_end_car_and_adversary_touch(subject):
    """By shapely, of the outlines that are drawn; and the gap over time is the distance of outlines."""
    number = int(np.flatnonzero(subject.episodes.hit)[0])
    shown = shown_episode(subject, number)
    picture = EpisodePicture(shown)
    radius = subject.scenario.adversary.radius
    for time in (0.0, 0.45, float(shown.times[-1])):
        picture.set(time)
        place = [np.interp(time, shown.times, shown.adversary[:, axis]) for axis in (0, 1)]
        apart = max(0.0, Polygon(picture._car.get_xy()).distance(Point(place)) - radius)
        gaps, away = shown.distances(np.array([time]))
        assert gaps[0] == pytest.approx(apart, abs=1e-9)
        assert Polygon(picture._user.get_xy()).centroid.distance(Point(place)) < 1e-9
    assert gaps[0] < 1e-6
    assert away[0] <= subject.episodes.deviation[number] + 1e-9
