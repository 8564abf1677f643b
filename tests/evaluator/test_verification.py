"""Results are what was written, as their manifest says; `skd verify` computes them again; what cannot be is refused."""

import hashlib
import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import one_line
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from report_support import edit
from skd_evaluator.assessment.files.episodes_npz import StoredEpisodes, read_episodes
from skd_evaluator.assessment.files.result_folder import MANIFEST, write_manifests
from skd_evaluator.assessment.files.verification import verify
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.metrics.behaviour.model import load_behaviour, write_behaviour
from skd_sim.errors import UsageError

CHANGES: dict[str, Any] = {
    "skd": 9.9,
    "contact_rate": 0.123,
    "margin": 4.9,
    "margin_ci95.0": 0.01,
    "objectives.paper.skd": 9.9,
    "vulnerability_curve.margins.points.20.probability": 0.123,
    "per_safe_trajectory.1.name": "another",
    "skd_ci95": None,
    "clustering.skd.standard_error": 0.001,
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_figure_that_does_not_follow_from_the_episodes_is_named(result: Path, name: str) -> None:
    edit(result, {name: CHANGES[name]})
    found = verify(result)
    assert not found.fine
    assert [line for line in found.contradict if line.startswith(f"{name} is ")], found.contradict


def test_verify_says_what_agrees_and_what_cannot_be_computed(result: Path, skd_here) -> None:
    done = skd_here("verify", str(result))
    assert done.returncode == 0
    assert "figures recomputed, all as stored" in done.stdout
    (one,) = json.loads(skd_here("verify", str(result), "--json").stdout)["results"]
    assert one["fine"]
    assert {"margin", "skd", "skd_ci95", "contact_rate", "measures", "clustering", "objectives"} <= {*one["agree"]}
    assert one["contradict"] == one["problems"] == []
    assert one["files"] == {}
    assert "margin_converged" in one["unknown"]
    edit(result, {"skd": 9.9})
    done = skd_here("verify", str(result))
    assert done.returncode == 1
    assert "NOT FINE" in done.stdout
    assert "contradicted: skd is 9.9, its episodes give" in done.stdout


def test_a_result_has_a_manifest_of_all_its_files(sweep: Path) -> None:
    for folder in (sweep, sweep / "synthetic" / "C_1"):
        lines = (folder / MANIFEST).read_text().splitlines()
        said = {line[66:]: line[:64] for line in lines}
        files = [path for path in folder.rglob("*") if path.is_file() and path != folder / MANIFEST]
        digests = {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
        assert said == {path.relative_to(folder).as_posix(): digest for path, digest in digests.items()}


def test_verify_says_which_files_changed(result: Path, skd_here) -> None:
    (result / "trajectories.png").write_bytes(b"another")
    (result / "vulnerability.png").unlink()
    (result / "notes.txt").write_text("mine")
    (result / f"{MANIFEST}.sig").write_text("of whoever signed it")
    done = skd_here("verify", str(result))
    assert done.returncode == 1
    for line in ("trajectories.png: changed", "vulnerability.png: gone", "notes.txt: not of this result"):
        assert line in done.stdout
    assert ".sig" not in done.stdout


def test_verify_reads_sweeps_and_says_what_is_none(sweep: Path, result: Path, skd_here, here: Path) -> None:
    assert skd_here("verify", str(sweep)).stdout.count(": fine") == 3
    (result / MANIFEST).unlink()
    without = skd_here("verify", str(result))
    assert without.returncode == 0
    assert f"no {MANIFEST}" in without.stdout
    (here / "nothing").mkdir()
    one_line(skd_here("verify", "nothing"), 2, "holds no assessment.json")
    one_line(skd_here("verify", "nowhere"), 2, "no such folder")
    for command in ("verify", "report", "compare", "list"):
        one_line(skd_here(command, __file__), 2, "is a file; give the folder of a result")
    (result / "assessment.json").unlink()
    (result / MANIFEST).write_text(f"{'0' * 64}  assessment.json\n")
    gone = verify(result)
    assert not gone.fine
    assert "assessment.json: cannot be read" in gone.problems[0]


@pytest.mark.parametrize("name", ["assessment.json", "episodes.npz"])
def test_every_reader_refuses_a_file_that_was_changed_in_one_line(result, sweep, skd_here, name) -> None:
    (result / name).write_bytes((result / name).read_bytes() + b" ")
    for words in (
        ("report", result, "--out", "r.html"),
        ("compare", sweep / "synthetic" / "C_0.5", result, "--out", "compared"),
        ("compare", result, "--width", "0.2"),
        ("assess", "--fail-if-worse-than", result, "--out", "assessed"),
    ):
        one_line(skd_here(*map(str, words)), 2, f"{name}: is not what was written")


def said_by(stored: StoredEpisodes) -> list[bytes]:
    arrays = [*stored.safe, *stored.adversary, *stored.car, stored.outcome, stored.impact_time, stored.impact_speed]
    return [np.asarray(one).tobytes() for one in arrays]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_whatever_is_damaged_in_episodes_is_refused_or_says_the_same(sweep: Path, tmp_path: Path, data) -> None:
    """A bit anywhere, a part that is cut out, or a value of any array that is another; nothing else is ever raised."""
    content = (sweep / "synthetic" / "C_1" / "episodes.npz").read_bytes()
    right = said_by(read_episodes(sweep / "synthetic" / "C_1"))
    begin, kind = data.draw(st.integers(0, len(content) - 1)), data.draw(st.sampled_from(["bit", "cut", "value"]))
    if kind == "bit":
        content = content[:begin] + bytes([content[begin] ^ 1 << data.draw(st.integers(0, 7))]) + content[begin + 1 :]
    elif kind == "cut":
        content = content[:begin] + content[begin + data.draw(st.integers(1, len(content) - begin)) :]
    else:
        with np.load(io.BytesIO(content)) as archive:
            arrays = {name: archive[name].copy() for name in archive.files}
        name = data.draw(st.sampled_from([one for one, values in arrays.items() if values.dtype.kind in "if"]))
        values = arrays[name].reshape(-1)
        value = data.draw(st.sampled_from([-1, 0, 2**31 - 1] if values.dtype.kind == "i" else [-1e9, np.nan, np.inf]))
        if not values.size or value > np.iinfo(values.dtype).max if values.dtype.kind == "i" else not values.size:
            return
        values[data.draw(st.integers(0, len(values) - 1))] = value
        arrays[name] = values.reshape(arrays[name].shape)
        stream = io.BytesIO()
        np.savez(stream, **arrays)
        content = stream.getvalue()
    (tmp_path / "episodes.npz").write_bytes(content)
    try:
        stored = read_episodes(tmp_path)
    except UsageError as error:
        assert str(tmp_path) in str(error)  # noqa: PT017
        return
    assert kind == "value" or said_by(stored) == right


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("multiplier", "abc"),
        ("eta_max", 0.0),
        ("objectives.deviation.measures", None),
        ("aborted_reasons", [1]),
        ("scenario.car", None),
    ],
)
@pytest.mark.parametrize("command", ["report", "compare"])
def test_a_value_of_another_kind_is_said_in_one_line(result, sweep, skd_here, name, value, command):
    edit(result, {name: value})
    words = {
        "report": ["report", result, "--out", "r.html"],
        "compare": ["compare", sweep / "synthetic" / "C_0.5", result, "--out", "compared"],
    }[command]
    one_line(skd_here(*map(str, words)), 2, "assessment.json")


def test_a_model_that_was_changed_where_it_was_written_is_refused(tmp_path):
    behaviour = tmp_path / "fitted" / "behaviour.yaml"
    behaviour.parent.mkdir()
    write_behaviour(behaviour, load_behaviour("walkers"))
    write_manifests(behaviour.parent)
    assert risk_request(str(behaviour.parent)).behaviour == load_behaviour("walkers")
    text = behaviour.read_text()
    behaviour.write_text(text.replace("value: 0.3\n", "value: 0.0\n"))
    for source in (behaviour, behaviour.parent):
        with pytest.raises(UsageError, match=r"behaviour\.yaml: is not what was written"):
            risk_request(str(source))
    shutil.copy(behaviour, tmp_path / "mine.yaml")
    assert risk_request(str(tmp_path / "mine.yaml")).behaviour != load_behaviour("walkers")
