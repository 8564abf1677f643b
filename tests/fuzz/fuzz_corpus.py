"""Makes the seeds of the fuzz targets anew: `python tests/fuzz/fuzz_corpus.py`, after a change of a format.

Inputs that have found something stand beside them as `found-…` and are kept.
"""

from __future__ import annotations

import itertools
import json
import shutil
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "exchange"))

from bag_forge import campaign_messages, write_mcap
from exchange_support import safe
from fuzz_targets import _CELL, _SPECIFICATION, CORPUS, TARGETS, as_messages, episode
from fuzz_trials import walk
from mcap.writer import CompressionType
from skd_adversary.car_forest import pack
from skd_adversary.car_model_file import car_model_data, read_car_model
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaigns.episode_record import to_bytes
from skd_evaluator.campaigns.store import EpisodeStore
from skd_evaluator.cli.main import main as skd
from skd_evaluator.exchange.going_out.formats import FORMATS
from skd_evaluator.measure.behaviour.model import load_behaviour
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import EpisodeLog, Mode, Outcome
from skd_sim.geometry.trajectory import Trajectory
from test_import import drive, write_bag

_SMALL = (
    "--safe-count", "1", "--kamikaze-count", "2", "--collision-runs", "2", "--simulations", "20", "--workers", "1",
    "--margin-limit", "2000", "--quiet",
)  # fmt: skip


def put(target: str, name: str, content: bytes, reader: int | None = None) -> None:
    path = CORPUS / target / name
    path.write_bytes((b"" if reader is None else bytes([reader])) + content)


def compact(path: Path) -> bytes:
    return json.dumps(json.loads(path.read_text()), ensure_ascii=False, separators=(",", ":")).encode()


def recordings(scratch: Path) -> None:
    plan = Plan(load_scenario("crossing"), multiplier=1.1, simulations=3, seed=2)
    phi = Trajectory(np.array([(-3.5 + 0.75 * tick, 0.1) for tick in range(10)]), 0.3, "brisk")
    logs = [run_episode(plan.episode(Mode.KAMIKAZE, 0, attempt, phi)) for attempt in range(2)]
    logs.append(run_episode(plan.episode(Mode.REPLAY, 0, 0, phi)))
    sent = [one for each in campaign_messages(logs) for one in each]
    forms = {
        "plain": {"chunks": False, "checksums": False},
        "zstd": {"compression": CompressionType.ZSTD, "chunk_size": 4096, "checksums": False},
        "lz4": {"compression": CompressionType.LZ4},
    }
    for name, options in forms.items():
        put("mcap", name, write_mcap(scratch / f"{name}.mcap", sent, **options).read_bytes())
    numbers: dict[str, int] = {}
    for one in sent:
        numbers.setdefault(one.topic, len(numbers) + 1)
    messages = [(numbers[one.topic] - 1, one.bytes()) for one in sent]
    put("cdr", "campaign", as_messages(messages))
    last = next(place for place, one in enumerate(sent) if "result" in one.topic)
    put("cdr", "episode", as_messages(messages[: last + 1]))
    for topic, number in numbers.items():
        place = next(place for place, one in enumerate(sent) if one.topic == topic)
        put("cdr", f"message-{number}", as_messages(messages[place : place + 1]))


def documents(scratch: Path) -> None:
    assert skd(["assess", *_SMALL, "--out", str(scratch / "result")]) == 0
    assert skd(["probe", "--episodes", "40", "--quiet", "--out", str(scratch / "probe")]) == 0
    assert skd(["fit", str(scratch / "probe"), "--quiet", "--out", str(scratch / "fit")]) == 0
    scenario = load_scenario("crossing").as_dict()
    text = yaml.safe_dump(scenario, sort_keys=False).encode()
    put("yaml", "scenario.yaml", text, 0)
    campaign = (CORPUS.parents[2] / "examples" / "campaign" / "versions.yaml").read_bytes()
    put("yaml", "versions.yaml", campaign, 1)
    put("yaml", "sweep.yaml", (CORPUS.parents[2] / "examples" / "campaign" / "sweep.yaml").read_bytes(), 1)
    block = b"rosbag2_bagfile_information:\n  relative_file_paths:\n    - x.mcap\n    - y.mcap\n"
    put("yaml", "metadata.yaml", block, 2)
    put("yaml", "flow-metadata.yaml", b"{rosbag2_bagfile_information: {relative_file_paths: [x.mcap]}}", 2)
    put("yaml", "manifest", f"{'0' * 64}  x.mcap\n{'1' * 64}  y/z.mcap\n".encode(), 3)
    put("json", "assessment.json", compact(scratch / "result" / "assessment.json"), 0)
    put("json", "probe.json", compact(scratch / "probe" / "probe.json"), 1)
    put("json", "cells.json", b'{"cells":[{"name":"a"},{"name":"b","seed":1}]}', 2)
    put("json", "campaign.json", b'{"cells":[{"name":"a","state":"done","skd":1.5},{"name":"b","state":"open"}]}', 3)
    put("json", "scenario.json", json.dumps(scenario, separators=(",", ":")).encode(), 4)
    put("json", "options.json", b'{"knowledge":"nothing","controller_calls":5}', 5)
    model = car_model_data(read_car_model(scratch / "fit"))
    model = {**model, "families": model["families"][:1], "predictions": model["predictions"][:1]}
    put("json", "model.json", json.dumps(model, separators=(",", ":")).encode(), 6)
    put("json", "same-model.json", json.dumps(model, separators=(",", ":")).encode(), 7)
    answer = json.dumps({"what": "a text"}).encode()
    for kind in (1, 2, 3):
        put("json", f"answer-{kind}", np.array([len(answer)], "<f8").tobytes().join((bytes([kind]), answer)), 8)
    put("car_model", "car_model.yaml", yaml.safe_dump(model, sort_keys=False).encode(), 0)
    put("npz", "assessed.npz", (scratch / "result" / "episodes.npz").read_bytes(), 0)
    put("npz", "log.npz", (scratch / "result" / "episodes.npz").read_bytes(), 1)
    for reader in (2, 3):
        put("npz", f"members-{reader}", b"\x00\x80\x00\x08" + bytes(8) + b"\x05\x10\x00\x02ab", reader)


def tables_forests_stores(scratch: Path) -> None:
    rows = [f"{0.3 * tick!r},{-3.5 + 0.75 * tick!r},0.0" for tick in range(9)]
    put("csv", "walk.csv", ("t,x,y\n" + "\n".join(rows) + "\n").encode())
    put("csv", "quoted.csv", b'"t","x" ,y,"a ""note"""\r\n0,-3.5,0,"b\n,c"\r\n0.3,-3.2,0,\r\n')
    forest = pack(
        np.array([0, -1, -1], np.int8),
        np.array([128], np.int16),
        np.array([3], np.uint32),
        np.array([[100, 0, 0, 0, 900, 10, 1], [1000, 0, 0, 0, 900, -10, 2]], np.int16),
        np.array([2], np.uint16),
        time_step=0.3,
        car_length=4.0,
    )
    put("car_model", "forest", forest.packed, 1)
    put("car_model", "forest-inside", zlib.decompress(forest.packed), 2)
    path = scratch / "episodes.sqlite"
    states = np.arange(6.0).reshape(2, 3)
    log = EpisodeLog(episode(), Outcome.ARRIVED, states[:, :2].copy(), states, np.nan, np.nan, reason="é")
    store = EpisodeStore(path)
    store.put(_CELL, _SPECIFICATION, log)
    store.put(bytes(15) + b"1", _SPECIFICATION, log)
    store.close()
    put("store", "two.sqlite", path.read_bytes(), 0)
    put("store", "record", to_bytes(log), 1)


def exchanged(scratch: Path) -> None:
    phi = np.array([(-3.5 + 0.75 * tick, 0.1) for tick in range(4)])
    one = safe("crossing", phi)
    for reader, (name, kind) in enumerate((("openscenario", "xosc"), ("commonroad", "xml"), ("csv", "csv"))):
        FORMATS[name].write(scratch / f"a.{kind}", one)
        text = (scratch / f"a.{kind}").read_text("utf-8").splitlines()
        put("exchange", name, "\n".join(line.strip() for line in text).encode(), reader)
    rows = [
        f"{id_},{frame},{-3.5 + 0.05 * frame},{7 - id_ * frame}" for id_ in (1, 2) for frame in range(0, 100, 20 - id_)
    ]
    put("exchange", "tracks", ("trackId,frame,xCenter,yCenter\n" + "\n".join(rows) + "\n").encode(), 3)
    FORMATS["osi"].write(scratch / "a.mcap", one)
    put("exchange", "osi", (scratch / "a.mcap").read_bytes(), 4)
    write_bag(scratch / "b.mcap", itertools.islice(drive(), 9))
    put("exchange", "bag", (scratch / "b.mcap").read_bytes(), 5)


def trials(scratch: Path) -> None:
    rows = "walk,0,0.4,3.5,12.5\nwalk,1,0,,30\n"
    put("trials", "trials.csv", f"phi,hit,clearance,required_deceleration,gap\n{rows}".encode(), 0)
    put("trials", "recordings.csv", b"phi,file\nwalk,recorded.csv\n", 0)
    places = [(0.3 * tick, x, y) for tick, (x, y) in enumerate(walk())]
    table = "t,id,x,y,heading,speed\n"
    table += "".join(f"{t:.1f},other,{x:.2f},{y:.2f},,\n" for t, x, y in places)
    table += "".join(f"{t:.1f},car,0,{-30.0 + 3.0 * t:.2f},1.5708,3\n" for t, _, _ in places)
    put("trials", "recorded.csv", table.encode(), 1)
    behaviour = load_behaviour("walkers")
    put("trials", "behaviour.yaml", yaml.safe_dump(behaviour.as_dict(), allow_unicode=True).encode(), 2)
    sway = 0.02 * np.sin(np.arange(40))
    rows = "".join(f"{0.3 * k:.1f},{0.4 * k + sway[k]:.3f},{sway[k]:.3f}\n" for k in range(40))
    put("trials", "track.csv", f"t,x,y\n{rows}".encode(), 3)
    words = ["--encounters", "cpna", "--speeds", "20:40:20", "--kamikaze-count", "1", "--quiet"]
    assert skd(["ncap", *words, "--out", str(scratch / "ncap")]) == 0
    put("trials", "ncap.json", compact(scratch / "ncap" / "ncap.json"), 4)


def main() -> None:
    for name in TARGETS:
        (CORPUS / name).mkdir(parents=True, exist_ok=True)
        for path in (CORPUS / name).iterdir():
            if not path.name.startswith("found-"):
                path.unlink()
    with tempfile.TemporaryDirectory() as scratch:
        recordings(Path(scratch))
        documents(Path(scratch))
        tables_forests_stores(Path(scratch))
        exchanged(Path(scratch))
        trials(Path(scratch))
        for target in TARGETS.values():
            for data in target.seeds():
                folder = Path(tempfile.mkdtemp(dir=scratch))
                print(f"{target.name}: {len(data)} bytes: {target.run(data, folder) or 'read'}")
                shutil.rmtree(folder)


if __name__ == "__main__":
    main()
