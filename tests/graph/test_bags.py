"""Bags of a graph, and their recorder."""

from pathlib import Path

import pytest
from graph_support import Campaign, assert_same_results, skd_here
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

MESSAGES = Path(__file__).resolve().parents[2] / "ros_ws" / "src" / "skd_msgs" / "msg"
TOPICS = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/ego/odometry": "nav_msgs/msg/Odometry",
    "/adversary/odometry": "nav_msgs/msg/Odometry",
    "/ego/acceleration_command": "geometry_msgs/msg/AccelStamped",
    "/adversary/velocity_command": "geometry_msgs/msg/TwistStamped",
    "/skd/episode": "skd_msgs/msg/Episode",
    "/skd/episode_result": "skd_msgs/msg/EpisodeResult",
    "/skd/markers": "visualization_msgs/msg/MarkerArray",
    "/skd/clearance": "std_msgs/msg/Float64",
    "/skd/command": "geometry_msgs/msg/AccelStamped",
    "/skd/deviation": "std_msgs/msg/Float64",
    "/robot_description": "std_msgs/msg/String",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
}


@pytest.fixture(scope="module")
def store() -> Typestore:
    """A type store made from the definitions, independently of the code under test."""
    made = get_typestore(Stores.ROS2_JAZZY)
    for file in MESSAGES.glob("*.msg"):
        made.register(get_types_from_msg(file.read_text(), f"skd_msgs/msg/{file.stem}"))
    return made


def test_rosbags_reads_them_by_their_own_definitions(campaign: Campaign) -> None:
    for bag in sorted(campaign.bags.iterdir()):
        with AnyReader([bag]) as reader:
            seen: dict[str, int] = {}
            for connection, _, data in reader.messages():
                message = reader.deserialize(data, connection.msgtype)
                seen[connection.topic] = seen.get(connection.topic, 0) + 1
                if connection.topic == "/skd/episode_result":
                    ticks = message.ticks
        assert set(seen) == set(TOPICS)
        assert seen["/skd/episode"] == seen["/skd/episode_result"] == 1
        assert seen["/ego/odometry"] >= ticks + 1
        assert seen["/adversary/odometry"] >= ticks + 1
        assert seen["/ego/acceleration_command"] >= ticks
        assert seen["/adversary/velocity_command"] >= ticks


def test_they_show_the_car_where_it_was(campaign: Campaign, store: Typestore) -> None:
    """Each state has its transform, all frames hang together, and the markers follow car and adversary."""
    for bag in sorted(campaign.bags.iterdir()):
        poses, transforms, frames, places, looks = {}, {}, set(), {}, []
        with Reader(bag) as reader:
            for connection, time, data in reader.messages():
                message = store.deserialize_cdr(data, connection.msgtype)
                if connection.topic == "/ego/odometry":
                    poses[time] = message.pose.pose
                elif connection.topic in ("/tf", "/tf_static"):
                    frames |= {(one.header.frame_id, one.child_frame_id) for one in message.transforms}
                    if connection.topic == "/tf":
                        transforms[time] = message.transforms[0].transform
                elif connection.topic == "/skd/markers":
                    places[time] = [one.pose.position for one in message.markers if one.type == 1]  # CUBE: the car
                elif connection.topic == "/robot_description":
                    looks.append(message.data)
        assert frames == {("map", "odom"), ("odom", "base_link"), ("base_link", "laser"), ("map", "adversary")}
        assert len(looks) == 1
        assert set(transforms) == set(places) == set(poses)
        for time, pose in poses.items():
            moved = transforms[time]
            assert (moved.translation.x, moved.translation.y) == (pose.position.x, pose.position.y)
            assert moved.rotation == pose.orientation
            assert [(at.x, at.y) for at in places[time]] == [(pose.position.x, pose.position.y)]


def test_metadata_and_type_hashes_are_those_that_rosbags_computes(campaign: Campaign, store: Typestore) -> None:
    for bag in sorted(campaign.bags.iterdir()):
        with Reader(bag) as reader:
            assert {c.topic: c.msgtype for c in reader.connections} == TOPICS
            for connection in reader.connections:
                assert connection.digest == store.hash_rihs01(connection.msgtype), connection.msgtype
            assert reader.message_count == sum(1 for _ in reader.messages())


def test_each_of_several_campaigns_can_be_replayed(campaigns, tmp_path, capsys):
    """A folder of one as it is; of two one is to be chosen."""
    both, out = [one.bags for one in campaigns.values()], tmp_path / "alone"
    assert skd_here(capsys, "replay", campaigns[1.0].bags, "--out", out).code == 0
    assert_same_results(out, campaigns[1.0].graph)
    for chosen, said in (((), "2 campaigns; choose one with --campaign: "), (("--campaign", "no-such"), "no-such")):
        refused = skd_here(capsys, "replay", *both, *chosen, "--out", tmp_path / "refused")
        assert refused.code == 2
        (line,) = refused.lines
        assert said in line
        assert not (tmp_path / "refused").exists()
    names = sorted(line.split(": ")[-1].removeprefix("the bags hold ").split(", "))
    for name, live in zip(names, (campaigns[0.5], campaigns[1.0]), strict=True):
        assert skd_here(capsys, "replay", *both, "--campaign", name, "--out", tmp_path / name).code == 0
        assert_same_results(tmp_path / name, live.graph)
