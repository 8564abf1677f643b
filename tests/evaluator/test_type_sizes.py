"""No type in a picture is smaller than 8 pt when the picture is as wide as a page."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from skd_evaluator.cli.main import main
from skd_evaluator.saved_picture import PAGE, TYPE

pytestmark = pytest.mark.usefixtures("pictures_drawn")


@pytest.fixture
def saved(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    """Every picture that is saved, by the name of its file."""
    found: dict[str, Figure] = {}
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: found.__setitem__(Path(path).name, self))
    return found


def smallest(figure: Figure) -> tuple[float, str]:
    """The least size of type, pt, with the picture as wide as a page at most, and what is written so."""
    shrunk = min(1.0, PAGE / figure.get_figwidth())
    shown = [one for one in figure.findobj(Text) if one.get_visible() and one.get_text().strip()]
    return min((shrunk * one.get_fontsize(), one.get_text()) for one in shown)


def test_pictures_of_results(tmp_path, sweep, saved):
    one, two = (str(sweep / "synthetic" / name) for name in ("C_0.5", "C_1"))
    assert main(["show", one, "--objective", "deformation", "--out", str(tmp_path / "show")]) == 0
    assert main(["compare", one, two, "--out", str(tmp_path / "compare")]) == 0
    assert main(["trend", one, two, "--out", str(tmp_path / "trend")]) == 0
    words = (
        "--safe-count",
        "2",
        "--kamikaze-count",
        "2",
        "--collision-runs",
        "2",
        "--simulations",
        "20",
        "--workers",
        "1",
    )
    assert main(["assess", *words, "--out", str(tmp_path / "assess")]) == 0
    assert {"1.png", "vulnerability.png", "rating.png", "trend.png", "trajectories.png"} <= set(saved)
    small = {name: found for name, figure in saved.items() if (found := smallest(figure))[0] < TYPE - 1e-9}
    assert small == {}


def test_the_circles_are_in_the_legend(tmp_path, saved):
    words = (
        "--safe-count",
        "1",
        "--kamikaze-count",
        "3",
        "--collision-runs",
        "1",
        "--simulations",
        "20",
        "--workers",
        "1",
    )
    assert main(["assess", *words, "--objective", "deformation", "--out", str(tmp_path / "assess")]) == 0
    (legend,) = saved["trajectories.png"].legends
    said = [text.get_text() for text in legend.get_texts()]
    assert "outline of the adversary at the hit" in said
    assert "its front at the ticks before, with their times" in said
    title = saved["trajectories.png"].axes[0].get_title()
    assert "3 kamikazes, 3 ways of the margin" in title
