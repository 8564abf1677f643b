"""Whatever the bytes of a file of somebody else: a command takes it, or says in one line what is wrong with it.

Each reader gets damaged files: bytes flipped, cut, put elsewhere; a word replaced by another; bytes at random. An
exception that is no error of the user leaves `run_skd`, and fails the test.
"""

import contextlib
import io
import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from bag_forge import campaign_messages, write_mcap
from common import run_skd
from hypothesis import given, settings
from hypothesis import strategies as st
from skd_sim import EpisodeLog, load_scenario

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SMALL = (
    "--safe-count", "1", "--kamikaze-count", "2", "--collision-runs", "2", "--simulations", "20", "--workers", "1",
    "--margin-limit", "0", "--behaviour", "none", "--quiet",
)  # fmt: skip
WORDS = [
    b"", b"-1", b"0", b"1e308", b"1e999", b"nan", b"-inf", b"null", b"true", b"[]", b"{}", b"\x00", b"\xff\xfe",
    b"9" * 40, b"\x1b[2J", "\u202eφ".encode(), b"../../x", b"a: b", b"'", b'"', b"<", b"2020-01-01",
]  # fmt: skip
"""What may stand where something else belongs."""

# What is read → (file, command that reads it); `{}` is the folder of the file.
READERS = {
    "recording": ("x.mcap", ("replay", "{}/x.mcap", "--margin-limit", "0", "--skip-damaged", "--quiet")),
    "result": ("result/assessment.json", ("verify", "{}/result")),
    "episodes": ("result/episodes.npz", ("verify", "{}/result")),
    "manifest": ("result/manifest.sha256", ("verify", "{}/result")),
    "scenario": ("x.yaml", ("scenarios", "check", "{}/x.yaml")),
    "campaign": ("c.yaml", ("campaign", "{}/c.yaml", "--dry-run")),
    "safe trajectories": ("phi.csv", ("assess", "--safe", "{}/phi.csv", *SMALL)),
    "car model": ("car_model.yaml", ("assess", "--car-model", "{}/car_model.yaml", "--controller", "carla", *SMALL)),
    "OpenSCENARIO": ("x.xosc", ("import", "{}/x.xosc", "--quiet")),
    "CommonRoad": ("x.xml", ("import", "{}/x.xml", "--quiet")),
    "tracks": ("t.csv", ("import", "{}/t.csv", "--quiet")),
    "trials": ("trials.csv", ("fuse", "{}/result", "{}/trials.csv", "--quiet")),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, logs: list[EpisodeLog]) -> Path:
    folder = tmp_path_factory.mktemp("files")
    assert run_skd("assess", *SMALL, "--safe-count", "5", "--collision-runs", "5", "--out", folder / "result") == 0
    assert run_skd("probe", "--episodes", "40", "--quiet", "--out", folder / "probe") == 0
    assert run_skd("fit", folder / "probe", "--quiet", "--out", folder / "fit") == 0
    shutil.copy(folder / "fit" / "car_model.yaml", folder)
    messages = [one for each in campaign_messages(logs) for one in each]
    write_mcap(folder / "x.mcap", messages, chunks=False, checksums=False)
    (folder / "x.yaml").write_text(yaml.safe_dump(load_scenario("crossing").as_dict(), sort_keys=False))
    shutil.copy(EXAMPLES / "campaign" / "sweep.yaml", folder / "c.yaml")
    walked = [(0.3 * tick, -3.5 + 0.75 * tick) for tick in range(10)]
    (folder / "phi.csv").write_text("t,x,y\n" + "".join(f"{t:.1f},{x:.2f},0.1\n" for t, x in walked))
    (folder / "t.csv").write_text("t,id,x,y\n" + "".join(f"{t:.1f},walker,{x:.2f},0.1\n" for t, x in walked))
    result = json.loads((folder / "result" / "assessment.json").read_text())
    rows = "".join(f"{one['name']},0,0.4\n{one['name']},1,0\n" for one in result["per_safe_trajectory"])
    (folder / "trials.csv").write_text(f"phi,hit,clearance\n{rows}")
    for name, ending in (("openscenario", "xosc"), ("commonroad", "xml")):
        assert run_skd("export", folder / "result", "--format", name, "--out", folder / name) == 0
        shutil.copy(next((folder / name).rglob(f"*.{ending}")), folder / f"x.{ending}")
    return folder


def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """Return the content of a file with up to three faults."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(data)))
        length = draw(st.integers(0, 12))
        how = draw(st.sampled_from(["other", "other", "word", "word", "gone", "cut", "moved"]))
        if how == "other":
            data[place : place + length] = draw(st.binary(min_size=length, max_size=length))
        elif how == "word":  # from one end of a word, or a number, to its other one
            end = place
            while end < len(data) and (chr(data[end]).isalnum() or data[end] in b".-+_"):
                end += 1
            data[place:end] = draw(st.sampled_from(WORDS))
        elif how == "gone":
            del data[place : place + length]
        elif how == "cut":
            del data[place:]
        else:
            data[place:place] = data[:length]
    return bytes(data)


def damaged_archive(draw: st.DrawFn, content: bytes) -> bytes:
    """Return an archive of arrays of which one has faults, with checksums that are right."""
    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as read, zipfile.ZipFile(written, "w") as archive:
        chosen = draw(st.sampled_from(read.namelist()))
        for name in read.namelist():
            archive.writestr(name, damaged(draw, read.read(name)) if name == chosen else read.read(name))
    return written.getvalue()


@pytest.mark.parametrize("kind", READERS)
def test_a_file_is_taken_or_refused_in_one_line(kind: str, files: Path, tmp_path: Path) -> None:
    name, command = READERS[kind]
    shutil.copytree(files / "result", tmp_path / "result")
    content = (files / name).read_bytes()
    words = [word.replace("{}", str(tmp_path)) for word in command]
    writes = command[0] in ("assess", "import", "replay", "fuse")
    words += ["--out", str(tmp_path / "out"), "--overwrite"] if writes else []
    read = _reader((tmp_path / name), words)
    assert read(content) == 0

    @settings(max_examples=6 if command[0] == "assess" else 15)
    @given(st.data())
    def refuse(data: st.DataObject) -> None:
        how = data.draw(st.sampled_from(["damaged", "damaged", "damaged", "random"]))
        if how == "random":
            read(data.draw(st.binary(max_size=200)))
        elif name.endswith(".npz") and data.draw(st.booleans()):
            read(data.draw(st.composite(damaged_archive)(content)))
        else:
            read(data.draw(st.composite(damaged)(content)))

    refuse()


def _reader(path: Path, words: list[str]) -> Callable[[bytes], int]:
    """Return a function that writes a file, has a command read it, and returns the exit code."""

    def read(content: bytes) -> int:
        path.write_bytes(content)
        said = io.StringIO()
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            code = run_skd(*words)
        lines = said.getvalue().splitlines()
        assert code in (0, 1, 2), lines
        print(*lines, sep="\n")
        errors = [line for line in lines if ": warning: " not in line]
        if code == 2:
            assert len(errors) == 1, lines
            assert errors[0].startswith("skd"), lines
        return code

    return read
