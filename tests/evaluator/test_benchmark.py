"""skd benchmark: frozen trials, ranks with their uncertainty, and digests."""

import hashlib
import json
from pathlib import Path

import pytest
from skd_evaluator.cli.main import main
from skd_evaluator.extensions.campaign import benchmark

FROZEN = "a597b7b7f24ed08fe853ba7cc17caeb1122bbeb73370029af8c2ff429b15c089"
SMALL = """
defaults: {scenario: crossing, seed: 1, safe_count: 2, kamikaze_count: 1, collision_runs: 2, risk_runs: 4,
  margin_limit: 8, objective: deviation, simulations: 20, adversary_model: generic}
cars:
  - {controller: basic, multiplier: 0.5}
  - {controller: krauss}
"""


def test_the_benchmark_is_frozen():
    """Whoever changes it makes a new version beside it."""
    assert hashlib.sha256(benchmark.FILE.read_bytes()).hexdigest() == FROZEN


def test_a_digest_tells_every_bit():
    row = {"car": "a", "margin": {"value": 0.1, "ci95": (0.0, 0.3)}}
    other = {"car": "a", "margin": {"value": 0.1, "ci95": (0.0, 0.1 + 0.2)}}
    assert benchmark.digest_of(row) == benchmark.digest_of(json.loads(json.dumps(row)))
    assert benchmark.digest_of(row) != benchmark.digest_of(other)


@pytest.mark.parametrize(
    ("better", "expected"), [(1, [[3, 2, 3], [2, 1, 3], [1, 1, 2]]), (-1, [[1, 1, 2], [2, 1, 3], [3, 2, 3]])]
)
def test_a_rank_reaches_as_far_as_no_pair_is_told_apart(better, expected):
    """Of three cars only the first and the last are told apart: the last has more."""
    assert benchmark.ranks([1.0, 2.0, 3.0], better, {(0, 1): 0, (0, 2): 1, (1, 2): 0}) == expected


def test_cars_of_a_user_stand_beside_the_league_whose_digests_stay(tmp_path: Path, monkeypatch, capsys):
    (tmp_path / "small.yaml").write_text(SMALL)
    (tmp_path / "own.py").write_text(
        "class Sleeper:\n    def reset(self, scenario, rng): pass\n    def command(self, car, adversary): return 0.0\n"
    )
    monkeypatch.setattr(benchmark, "FILE", tmp_path / "small.yaml")
    monkeypatch.chdir(tmp_path)
    for out, cars in (("a", ["own.py:Sleeper"]), ("b", [])):
        assert main(["benchmark", *cars, "--out", out, "--workers", "1", "-q"]) == 0
    first, second = (json.loads((tmp_path / out / benchmark.RESULT).read_text()) for out in "ab")
    digests = [{row["car"]: row["digest"] for row in one["rows"]} for one in (first, second)]
    assert len(digests[0]) == 3
    assert digests[1].items() < digests[0].items()
    assert first["digest"] != second["digest"]
    assert first["file"] == second["file"] == hashlib.sha256(SMALL.encode()).hexdigest()
    assert first["rows"][0]["car"] == "krauss"
    page = (tmp_path / "a" / benchmark.PAGE).read_text(encoding="utf-8")
    assert all(row["digest"][:12] in page and f"| {row['car']} |" in page for row in first["rows"])
    assert first["digest"] in page
    assert (tmp_path / "a" / benchmark.PICTURE).exists()
    assert main(["benchmark", "--out", "b", "--resume", "--workers", "1"]) == 0
    assert second["digest"] in capsys.readouterr().out
