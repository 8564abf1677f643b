"""What benchmarks/track.py keeps, and what its check says of files that were made by hand; nothing is timed."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import track
from skd_sim.errors import UsageError

BEFORE = track.Record("a" * 40, False, "2026-01-01T00:00:00+00:00", "a machine", 20.0, {"pairs": [1.0, 1.1, 0.9]})
NOW = replace(BEFORE, revision="b" * 40, date="2026-02-01T00:00:00+00:00")


def kept(path: Path, *records: track.Record) -> Path:
    for one in records:
        track.append(path, one)
    return path


def checked(path: Path, *options: str) -> int:
    return track.main(["--no-measuring", "--check", "--file", str(path), *options])


def test_records_come_back_as_they_were_kept_a_line_each(tmp_path):
    path = kept(tmp_path / "track.jsonl", BEFORE, NOW)
    assert track.read(path) == [BEFORE, NOW]
    assert [json.loads(line) for line in path.read_text().splitlines()] == [asdict(BEFORE), asdict(NOW)]
    assert [one.name for one in tmp_path.iterdir()] == ["track.jsonl"]


@pytest.mark.parametrize(("ratio", "code"), [(1.049, 0), (1.051, 1), (0.5, 0)])
def test_the_median_of_the_runs_decides(ratio, code, tmp_path, capsys):
    now = replace(NOW, figures={"pairs": [ratio, 9.0, 0.1]})
    assert checked(kept(tmp_path / "track.jsonl", BEFORE, now)) == code
    assert ("SLOWER" in capsys.readouterr().out) == bool(code)
    assert checked(kept(tmp_path / "other.jsonl", BEFORE, now), "--loss", "0.1") == 0


def test_only_another_revision_of_the_same_machine_is_compared(tmp_path, capsys):
    elsewhere = replace(BEFORE, machine="another", figures={"pairs": [0.1]})
    again = replace(NOW, figures={"pairs": [0.1]})
    assert track.baseline([BEFORE, elsewhere, again], NOW) == BEFORE
    assert track.baseline([BEFORE, again], NOW, "bbb") == again
    assert checked(kept(tmp_path / "track.jsonl", elsewhere, NOW)) == 2
    assert "no record of another revision on this machine" in capsys.readouterr().err


def test_nothing_in_common_is_no_success(tmp_path):
    assert checked(kept(tmp_path / "track.jsonl", BEFORE, replace(NOW, figures={"others": [1.0]}))) == 1


def with_runs(*runs: object) -> str:
    return json.dumps({**asdict(BEFORE), "figures": {"pairs": runs}})


@pytest.mark.parametrize("line", ["{", "[]", "{}", with_runs(), with_runs("1"), with_runs(0.0)])
def test_a_line_that_is_no_record_is_named(line, tmp_path):
    path = kept(tmp_path / "track.jsonl", BEFORE)
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(UsageError, match=r"line 2: no record of track.py"):
        track.read(path)


def test_the_picture_is_drawn(tmp_path):
    path = kept(tmp_path / "track.jsonl", BEFORE, NOW)
    assert track.main(["--no-measuring", "--file", str(path), "--picture", str(tmp_path / "track.png")]) == 0
    assert (tmp_path / "track.png").read_bytes().startswith(b"\x89PNG")
