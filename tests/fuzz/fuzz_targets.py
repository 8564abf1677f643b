"""What is fuzzed: the readers of outside data, each given bytes as it would find them in a file or a message.

A target is right if it returns, or says in one line what is wrong. The first byte of an input chooses among the readers
of a target where it has several. Seeds stand in `corpus/TARGET`; `fuzz_corpus.py` makes them.
"""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_trials import behaviour_file, protocol_result, recorded_people, recorded_trial, trials_table
from skd_adversary.car_forest import CarForest
from skd_adversary.car_model_file import car_model_for_scenario, car_model_from, car_model_text, fitted_car
from skd_adversary.safe_trajectories.sources import load_safe_trajectories
from skd_evaluator.bags.acceptance import Damage
from skd_evaluator.bags.inventory import find_recordings
from skd_evaluator.bags.logs import _logs_in, _said_beside, recording_of
from skd_evaluator.bags.reader import read_bags
from skd_evaluator.bags.replay import rating_from
from skd_evaluator.campaign.store.manifest import read_manifest
from skd_evaluator.campaign.store.rebuilt import recompute
from skd_evaluator.campaign.store.result_file import read_figures, understood
from skd_evaluator.campaign.store.stored_episodes import read_episodes
from skd_evaluator.campaign.store.stored_result import read_result
from skd_evaluator.campaign.store.verification import verify
from skd_evaluator.campaigns.campaign_file import read_campaign
from skd_evaluator.campaigns.episode_record import from_bytes, to_bytes
from skd_evaluator.campaigns.folder import _read_json
from skd_evaluator.campaigns.store import EpisodeStore
from skd_evaluator.errors import AssessmentError
from skd_evaluator.exchange.coming_in.sources import Asked, read_sources
from skd_evaluator.exchange.coming_in.ways import way_of
from skd_evaluator.fusion.track import Frame
from skd_sim.choices.options import options_from_text
from skd_sim.encounter.scenario import Scenario, changed_scenario, load_scenario, scenario_from_dict
from skd_sim.episode.episode import Episode, Mode
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import parse_json

HERE = Path(__file__).resolve().parent
CORPUS = HERE / "corpus"
SAID = (UsageError, AssessmentError)
"""What a reader of outside data may raise."""
_CELL = _SPECIFICATION = bytes(16)


@dataclass(frozen=True)
class Target:
    """Readers of one kind of outside data.

    Attributes:
        name: what it is called; also its folder of seeds.
        readers: functions of the bytes and of a folder to write them into; the first byte of an input chooses one.
    """

    name: str
    readers: tuple[Callable[[bytes, Path], object], ...]

    def run(self, data: bytes, folder: Path) -> str:
        """Read an input; return what was said of it, in one line, empty where it was taken."""
        if len(self.readers) > 1:
            number, data = (data[0], data[1:]) if data else (0, b"")
        else:
            number = 0
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)  # of numbers that cannot be, on the user's terminal
                self.readers[number % len(self.readers)](data, folder)
        except SAID as error:
            said = str(error)
            assert "\n" not in said.replace(str(folder), ""), said
            return said or type(error).__name__
        return ""

    def seeds(self) -> Iterator[bytes]:
        """Yield the inputs of its folder."""
        for path in sorted((CORPUS / self.name).iterdir()):
            yield path.read_bytes()


@cache
def crossing() -> Scenario:
    """Return the scenario of what does not say its own."""
    return load_scenario("crossing")


# --- recordings


def _mcap(data: bytes, folder: Path) -> None:
    file = folder / "x.mcap"
    file.write_bytes(data)
    damage = Damage(skip=True)
    found = read_bags([file], damage)
    if found.episodes:
        rating_from(found, damage=damage)


@cache
def _beginning() -> bytes:
    """Return the beginning of a recording without chunks, up to its first message."""
    (whole,) = (path.read_bytes() for path in (CORPUS / "mcap").glob("plain"))
    place = 8
    while whole[place] != 5:
        place += 9 + struct.unpack_from("<Q", whole, place + 1)[0]
    definitions, at = whole[:place], place
    while at < len(whole) - 8 and whole[at] != 15:  # channels stand before their first message
        size = 9 + struct.unpack_from("<Q", whole, at + 1)[0]
        if whole[at] in (3, 4):
            definitions += whole[at : at + size]
        at += size
    return definitions


def as_recording(messages: list[tuple[int, bytes]]) -> bytes:
    """Return messages, each the number of its channel and its CDR, as a recording without checksums."""
    records = [struct.pack("<BQHIQQ", 5, 22 + len(one), channel, 0, 0, 0) + one for channel, one in messages]
    end = struct.pack("<BQI", 15, 4, 0) + struct.pack("<BQQQI", 2, 20, 0, 0, 0)
    return _beginning() + b"".join(records) + end + b"\x89MCAP0\r\n"


def as_messages(messages: list[tuple[int, bytes]]) -> bytes:
    """Return messages as an input of the target `cdr`."""
    return b"".join(struct.pack("<BH", channel, len(one)) + one for channel, one in messages)


def _cdr(data: bytes, folder: Path) -> None:
    messages, place = [], 0
    while place + 3 <= len(data):
        channel, size = struct.unpack_from("<BH", data, place)
        messages.append((channel % 4 + 1, data[place + 3 : place + 3 + size]))
        place += 3 + size
    _mcap(as_recording(messages), folder)


# --- YAML, JSON, tables


def _scenario_file(data: bytes, folder: Path) -> None:
    (folder / "x.yaml").write_bytes(data)
    load_scenario(str(folder / "x.yaml"))


def _campaign_file(data: bytes, folder: Path) -> None:
    (folder / "x.yaml").write_bytes(data)
    for cell in read_campaign(folder / "x.yaml")[:3]:
        changed_scenario("crossing", cell.changes)


def _metadata(data: bytes, folder: Path) -> None:
    (folder / "bag").mkdir(exist_ok=True)
    (folder / "bag" / "metadata.yaml").write_bytes(data)
    (folder / "bag" / "x.mcap").write_bytes(b"")
    find_recordings([folder / "bag"], Damage(skip=True))


def _manifest(data: bytes, folder: Path) -> None:
    (folder / "bag").mkdir(exist_ok=True)
    (folder / "bag" / "x.mcap").write_bytes(b"")
    (folder / "bag" / "manifest.sha256").write_bytes(data)
    read_manifest(folder / "bag")
    find_recordings([folder / "bag"], Damage(skip=True))


def _result_file(data: bytes, folder: Path) -> None:
    (folder / "result").mkdir(exist_ok=True)
    (folder / "result" / "assessment.json").write_bytes(data)
    (folder / "result" / "episodes.npz").write_bytes(seed_arrays("assessed"))
    read_result(folder / "result")
    verify(folder / "result")


def _beside(data: bytes, folder: Path) -> None:
    (folder / "assessment.json").unlink(missing_ok=True)
    (folder / "probe.json").write_bytes(data)
    _said_beside(folder / "episodes.npz")


def _cells(data: bytes, folder: Path) -> None:
    (folder / "cells.json").write_bytes(data)
    _read_json(folder / "cells.json")


def _rows(data: bytes, folder: Path) -> None:
    (folder / "campaign").mkdir(exist_ok=True)
    (folder / "campaign" / "campaign.json").write_bytes(data)
    verify(folder / "campaign")


def _scenario_text(data: bytes, _folder: Path) -> None:
    scenario_from_dict(parse_json(data, "here"), "here")


def _options(data: bytes, _folder: Path) -> None:
    options_from_text(data.decode("utf-8", "replace"), "here")


def _model_text(data: bytes, _folder: Path) -> None:
    text = data.decode("utf-8", "replace")
    fitted_car.__wrapped__(text)


def _table(data: bytes, folder: Path) -> None:
    (folder / "x.csv").write_bytes(data)
    load_safe_trajectories(folder / "x.csv", crossing(), 1)


# --- files of other tools


def _taken(name: str, asked: Asked = Asked()) -> Callable[[bytes, Path], object]:  # noqa: B008
    """Return a reader that takes ways out of a file with this name."""

    def read(data: bytes, folder: Path) -> None:
        (folder / name).write_bytes(data)
        for source in read_sources(folder / name, asked):
            way_of(source, Frame(1.0, 2.0, 0.3), 0.5, crossing())

    return read


def _tracks(data: bytes, folder: Path) -> None:
    (folder / "1_recordingMeta.csv").write_text("frameRate\n25\n")
    (folder / "1_tracksMeta.csv").write_text("trackId,class\n1,pedestrian\n2,car\n")
    _taken("1_tracks.csv", Asked("1", "2", needs_car=True))(data, folder)


# --- arrays


@cache
def seed_arrays(name: str) -> bytes:
    """Return an episodes.npz of the corpus, without the byte that chooses its reader."""
    return (CORPUS / "npz" / f"{name}.npz").read_bytes()[1:]


@cache
def _figures() -> bytes:
    return (CORPUS / "json" / "assessment.json").read_bytes()[1:]


def _of_result(data: bytes, folder: Path) -> None:
    (folder / "result").mkdir(exist_ok=True)
    (folder / "result" / "assessment.json").write_bytes(_figures())
    (folder / "result" / "episodes.npz").write_bytes(data)
    stored = read_episodes(folder / "result")
    figures = read_figures(folder / "result")
    with understood(folder / "result" / "assessment.json"):
        recompute(figures, stored)


def _of_log(data: bytes, folder: Path) -> None:
    (folder / "assessment.json").write_bytes(_figures())
    (folder / "episodes.npz").write_bytes(data)
    for log in _logs_in(folder / "episodes.npz"):
        recording_of(log)


def _replaced(data: bytes, name: str) -> bytes:
    """Return an episodes.npz in which the bytes of some members are others, with right checksums.

    Each is a byte that chooses the member, two that say where it begins to differ, one that says in how many bytes.
    """
    with zipfile.ZipFile(io.BytesIO(seed_arrays(name))) as archive:
        members = {one: bytearray(archive.read(one)) for one in archive.namelist()}
    names, place = sorted(members), 0
    while place + 4 <= len(data):
        chosen, start, size = struct.unpack_from("<BHB", data, place)
        new = data[place + 4 : place + 4 + size]
        content = members[names[chosen % len(names)]]
        start %= len(content) + 1
        content[start : start + len(new)] = new
        place += 4 + size
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w") as archive:
        for one, content in members.items():
            archive.writestr(one, bytes(content))
    return written.getvalue()


# --- car models, campaigns' episodes


def _model_file(data: bytes, folder: Path) -> None:
    (folder / "car_model.yaml").write_bytes(data)
    car_model_for_scenario(folder / "car_model.yaml", crossing())


def _forest(data: bytes, _folder: Path) -> None:
    CarForest(data).trees  # noqa: B018


def _forest_inside(data: bytes, _folder: Path) -> None:
    CarForest(zlib.compress(data, 1)).trees  # noqa: B018


def _model_json(data: bytes, _folder: Path) -> None:
    car_model_text(car_model_from(parse_json(data, "here"), "here"))


@cache
def episode() -> Episode:
    """Return an episode of which stores keep what happened."""
    return Episode(crossing(), Mode.SAFE, 0, 0)


def _database(data: bytes, folder: Path) -> None:
    path = folder / "episodes.sqlite"
    for suffix in ("", "-wal", "-shm", "-journal"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    path.write_bytes(data)
    store = EpisodeStore(path)
    try:
        store.count()
        if store.known(_CELL, [_SPECIFICATION]):
            to_bytes(store.get(_CELL, _SPECIFICATION, episode()))
        store.keep_only([_CELL])
    finally:
        store.close()


def _record(data: bytes, _folder: Path) -> None:
    try:
        log = from_bytes(data, episode())
    except ValueError:  # of which the store makes an error of one line
        return
    to_bytes(log)


TARGETS = {
    one.name: one
    for one in (
        Target("mcap", (_mcap,)),
        Target("cdr", (_cdr,)),
        Target("yaml", (_scenario_file, _campaign_file, _metadata, _manifest)),
        Target("json", (_result_file, _beside, _cells, _rows, _scenario_text, _options, _model_text, _model_json)),
        Target(
            "npz",
            (
                _of_result,
                _of_log,
                lambda data, folder: _of_result(_replaced(data, "assessed"), folder),
                lambda data, folder: _of_log(_replaced(data, "assessed"), folder),
            ),
        ),
        Target("csv", (_table,)),
        Target(
            "exchange",
            (
                _taken("x.xosc"),
                _taken("x.xml"),
                _taken("t.csv"),
                _tracks,
                _taken("x.mcap"),
                _taken("x.mcap", Asked("/tracks:42", "/tf:base_link", needs_car=True, map_frame="map")),
            ),
        ),
        Target("car_model", (_model_file, _forest, _forest_inside)),
        Target("store", (_database, _record)),
        Target("trials", (trials_table, recorded_trial, behaviour_file, recorded_people, protocol_result)),
    )
}


def arrays_of(content: bytes) -> dict[str, Any]:
    """Return the arrays of an episodes.npz."""
    with np.load(io.BytesIO(content)) as file:
        return {name: file[name].copy() for name in file.files}
