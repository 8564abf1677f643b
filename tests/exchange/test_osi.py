"""ASAM OSI: traces that ASAM's own reader opens, with the states and the metadata that have to be in them."""

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exchange_support import recorded, scenarios
from mcap.reader import make_reader
from mcap.writer import Writer
from skd_evaluator.assessment.files.episodes_npz import read_episodes
from skd_evaluator.extensions.exchange.osi import ground_truth, osi_name, read_osi, write_osi
from skd_sim import UsageError, load_scenario


def messages(path: Path) -> Iterator[Any]:
    from osi_utilities.tracefile.readers.multi import MultiTraceReader

    reader = MultiTraceReader(skip_incompatible_messages=False)
    assert reader.open(path)
    try:
        for one in reader:
            yield one.message
    finally:
        reader.close()


def states(path: Path) -> dict[int, np.ndarray]:
    """Time (s), x, y (m) and heading (rad) of each moving object."""
    found: dict[int, list[tuple[float, ...]]] = {}
    for message in messages(path):
        time = message.timestamp.seconds + 1e-9 * message.timestamp.nanos
        for one in message.moving_object:
            place = one.base.position
            found.setdefault(one.id.value, []).append((time, place.x, place.y, one.base.orientation.yaw))
    return {number: np.array(rows) for number, rows in found.items()}


def test_asams_own_library_reads_the_same_states(result: Path, skd_here, tmp_path: Path):
    done = skd_here("export", result, "--format", "osi", "--worst", "3", "--out", "out", "--json")
    assert done.returncode == 0, done.stderr
    episodes, scenario = read_episodes(result), load_scenario("bystanders")
    numbers = {(str(episodes.objective[k]), int(episodes.episode_id[k])): k for k in range(len(episodes))}
    files = json.loads(done.stdout)["files"]
    assert Counter(one["mode"] for one in files)["safe"] >= 1
    for one in files:
        found = states(tmp_path / "out" / one["file"])
        if one["mode"] == "safe":
            phi = episodes.safe[one["phi"]]
            assert 1 not in found  # the car is left out
            assert np.array_equal(found[2][:, 1:3], phi)
            continue
        number = numbers[one["objective"], one["episode_id"]]
        adversary, car = episodes.until_contact(number), episodes.car_until_contact(number, scenario)
        assert np.array_equal(found[2][:, 1:3], adversary)
        assert np.array_equal(found[1][:, 1:3], car[:, :2])  # the reference point is the middle of this car
        assert found[1][:, 3] == pytest.approx(np.pi / 2)
        if episodes.collided[number]:
            assert found[2][-1, 0] == pytest.approx(float(episodes.impact_time[number]), abs=1e-9)
        for index, other in enumerate(scenario.others):  # they go their own way
            grid = scenario.time_step * np.arange(len(adversary) + 1)
            way = np.array([state[:2] for state in other.states(len(adversary), scenario.time_step)])
            wanted = [np.interp(found[3 + index][:, 0], grid, column) for column in way.T]
            assert found[3 + index][:, 1:3] == pytest.approx(np.column_stack(wanted), abs=1e-6)


def test_ground_truth_on_two_topics_is_refused(tmp_path: Path):
    """Ids on one need not be those of the same objects on the other; one topic by itself is read."""
    one = recorded("cbna")
    path, both = tmp_path / osi_name(one), tmp_path / "both.mcap"
    write_osi(path, one)
    with path.open("rb") as stream, both.open("wb") as out:
        writer, channels = Writer(out), {}
        writer.start()
        for schema, channel, message in make_reader(stream).iter_messages():
            for topic in ("front", "rear"):
                if topic not in channels:
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[topic] = writer.register_channel(topic, channel.message_encoding, number)
                writer.add_message(channels[topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    assert {found.name for found in read_osi(path)} == {"Ego", "Adversary"}
    with pytest.raises(UsageError, match="ground truth on 'front', 'rear'; give a file with one"):
        read_osi(both)


def test_metadata_are_those_of_the_standard(tmp_path: Path):
    one = recorded("cbna")
    path = tmp_path / osi_name(one)
    write_osi(path, one)
    # <timestamp>_<type>_<osi-version>_<protobuf-version>_<number-of-frames>_<custom-trace-name>.mcap
    stamp, kind, version, _, frames, name = path.stem.split("_", 5)
    assert (stamp, kind, version, frames, name) == ("20260102T030405Z", "gt", "380", "9", "kamikaze")
    with path.open("rb") as stream:
        reader = make_reader(stream)
        (about,) = [one for one in reader.iter_metadata() if one.name == "net.asam.osi.trace"]
        (channel,) = reader.get_summary().channels.values()
        (schema,) = reader.get_summary().schemas.values()
    assert about.metadata["version"] == about.metadata["min_osi_version"] == "3.8.0"
    wanted = {"version", "min_osi_version", "max_osi_version", "min_protobuf_version", "max_protobuf_version"}
    assert wanted | {"zero_time", "creation_time", "description", "authors", "data_sources"} == set(about.metadata)
    assert channel.metadata["net.asam.osi.trace.channel.osi_version"] == "3.8.0"
    assert {one.rpartition(".")[2] for one in channel.metadata} == {"osi_version", "protobuf_version", "description"}
    assert (schema.name, schema.encoding, channel.message_encoding) == ("osi3.GroundTruth", "protobuf", "protobuf")


def test_everybody_of_every_scenario_is_in_it():
    for name in scenarios():
        one = recorded(name)
        first, *_, last = ground_truth(one)
        users = {found.id.value: found for found in first.moving_object}
        assert set(users) == set(range(1, 3 + len(one.scenario.others)))
        assert len(first.stationary_object) == len(one.scenario.obstacles)
        assert first.host_vehicle_id.value == 1
        car = one.scenario.car
        middle = 0.5 * (car.front - car.rear)
        base = users[1].base
        assert (base.dimension.length, base.dimension.width) == (car.front + car.rear, car.width)
        heading = base.orientation.yaw
        x, y = one.start[0] + middle * np.cos(heading), one.start[1] + middle * np.sin(heading)
        assert (base.position.x, base.position.y) == pytest.approx((x, y), abs=1e-9)
        for found in users.values():
            assert all(found.base.HasField(key) for key in ("velocity", "acceleration"))
            assert found.type in (found.TYPE_VEHICLE, found.TYPE_PEDESTRIAN)
        assert len(first.lane) == len(one.scenario.road.every_lane)
        assert len(first.lane_boundary) == 2 * len(first.lane)
        assert last.timestamp.seconds + 1e-9 * last.timestamp.nanos == pytest.approx(one.duration, abs=1e-9)
