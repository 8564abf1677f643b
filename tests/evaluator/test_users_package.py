"""A package of a user's own, installed beside SKD, adds one of each kind of thing that is chosen by name."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from cli_support import skd

DOCUMENT = (Path(__file__).resolve().parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
(TUTORIAL,) = re.findall(r"<!-- package -->\n```python\n(.*?)```", DOCUMENT, re.DOTALL)
SOURCE = f"""{TUTORIAL}


def _breaks(phi, pairs):
    raise RuntimeError("no idea")


BREAKS = Measure("broken", "", _breaks)
"""
(ENTRIES,) = re.findall(r"```toml\n(.*?)```", DOCUMENT, re.DOTALL)
ENTRIES = re.sub(r'\[project\.entry-points\."(.*?)"\]', r"[\1]", ENTRIES).replace('"', "")  # as pip writes them
ENTRIES += """
[skd.measures]
never = my_scenarios:NEVER
breaks = my_scenarios:BREAKS
"""
COUNTS = ("--safe-count", "1", "--kamikaze-count", "4", "--collision-runs", "2", "--simulations", "60", "--seed", "5")


def installed(folder: Path, name: str = "my_scenarios", entries: str = ENTRIES, source: str = SOURCE) -> Path:
    (folder / name).mkdir(parents=True)
    (folder / name / "__init__.py").write_text(source, encoding="utf-8")
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text(entries, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(tmp_path_factory.mktemp("site"))


def test_one_of_each(package: Path, tmp_path: Path):
    words = (
        "--details", "--controller", "careful", "--scenario", "quiet", "--objective", "near", "--simulator", "ice",
        "--workers", "1", "--adversary-model", "generic", "--margin-limit", "16", "--behaviour",
        "none", "--no-pictures",
    )  # fmt: skip
    done = skd("assess", *words, *COUNTS, "--out", tmp_path / "out", cwd=tmp_path, PYTHONPATH=str(package))
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out" / "assessment.json").read_text(encoding="utf-8"))
    assert (result["controller"], result["multiplier"]) == ("careful", None)
    assert (result["scenario"]["name"], result["scenario"]["horizon"]) == ("quiet", 12.0)
    assert list(result["objectives"]) == ["near"]
    assert result["options"] == {"simulator": "ice"}
    assert result["deviation"] == result["objectives"]["near"]["deviation"]
    # The measure's mean is that of the file's impact times.
    with np.load(tmp_path / "out" / "episodes.npz") as found:
        hits = (found["mode"] == 1) & (found["outcome"] == 1)
        times = found["impact_time"][hits]
        assert np.nanmin(found["car"][:, 2]) > 3.0  # nobody slowed down but by the noise, at most 5 % a tick
        assert set(found["objective"][found["mode"] == 1]) == {"near"}
    ends = result["measures"]["ends"]
    assert ends["pairs"] == len(times) == result["pairs"] > 1
    assert ends["mean"] == pytest.approx(times.mean(), rel=1e-12)
    half = 1.959963984540054 * times.std(ddof=1) / np.sqrt(len(times))
    assert ends["ci95_pairs"] == pytest.approx((times.mean() - half, times.mean() + half), rel=1e-9)
    never = result["measures"]["never"]
    assert (never["mean"], never["ci95"], never["pairs"], never["undefined"]) == (None, None, 0, len(times))
    assert result["measures"]["breaks"]["error"] == "RuntimeError: no idea"
    assert "time of the contact (s)" in done.stdout
    with np.load(tmp_path / "out" / "episodes.npz") as found:
        hard = int((hits & (found["impact_speed"] > 5.0)).sum())
    assert f"{hard} hits at more than 5 m/s" in result["warnings"]
    assert "broken" in done.stdout
    assert not re.search(r"^\W*nothing\b", done.stdout, re.MULTILINE)  # no row of that name


def test_a_road_user_of_another_kind(package: Path, tmp_path: Path):
    """That one rides within its own limits is tested with the package of examples/roundabout."""
    (tmp_path / "bike.yaml").write_text("name: bike\ndescription: x\nextends: cyclist\nadversary: {kind: cargo_bike}\n")
    words = ("episode", "--scenario", "bike.yaml", "--mode", "kamikaze", "--simulations", "60")
    done = skd(*words, cwd=tmp_path, PYTHONPATH=str(package))
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("entries", "words", "said"),
    [
        ("[skd.controllers]\nlost = my_scenarios:Nobody\n", ("--controller", "lost"), "my_scenarios has no Nobody"),
        ("[skd.simulators]\nlost = my_scenarios:Careful\n", ("--simulator", "lost"), "needs the methods reset"),
        ("[skd.measures]\nlost = my_scenarios:QUIET\n", (), "must be a Measure"),
        ("[skd.measures]\na_name_that_is_too_long = my_scenarios:ENDS\n", (), "at most 16"),
        ("[skd.stages]\nlost = nowhere:run\n", (), "stage 'lost' cannot be loaded"),
        ("[skd.objectives]\nlost = my_scenarios:QUIET\n", ("--objective", "lost"), "must be an ObjectiveModel"),
    ],
)
def test_what_cannot_be_loaded_is_one_line(tmp_path: Path, entries: str, words: tuple[str, ...], said: str):
    path = installed(tmp_path / "site", entries=entries)
    done = skd("assess", *words, *COUNTS, "--out", tmp_path / "out", cwd=tmp_path, PYTHONPATH=str(path))
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    assert said in line
    assert not (tmp_path / "out").exists()


def test_a_name_of_two_packages_is_refused(tmp_path: Path):
    entries = "[skd.controllers]\ncareful = {0}:Careful\n"
    source = "class Careful:\n    pass\n"
    for name in ("one", "another"):
        installed(tmp_path / "site", name, entries.format(name), source)
    words = ("assess", "--adversary-model", "generic", "--controller", "careful", *COUNTS)
    done = skd(*words, cwd=tmp_path, PYTHONPATH=str(tmp_path / "site"))
    assert done.returncode == 2
    assert "registered more than once: " in done.stderr
    assert "one:Careful" in done.stderr
