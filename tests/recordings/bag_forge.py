"""Writes episodes as recordings, ours or as another recorder would, with any field of any message changed.

Messages are made from the definitions by rosbags and files by the mcap package's own writer, so that nothing of the
code that reads them is used to make them.
"""

import dataclasses
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from skd_sim.options.options import options_to_text
from skd_sim.world.episode import EpisodeLog, controller_seed, next_start, tick_stamp

DEFINITIONS = Path(__file__).resolve().parents[2] / "ros_ws" / "src" / "skd_msgs" / "msg"
EPISODE, RESULT = "/skd/episode", "/skd/episode_result"
CAR, ADVERSARY = "/ego/odometry", "/adversary/odometry"
TYPES = {
    EPISODE: "skd_msgs/msg/Episode",
    RESULT: "skd_msgs/msg/EpisodeResult",
    CAR: "nav_msgs/msg/Odometry",
    ADVERSARY: "nav_msgs/msg/Odometry",
}

store = get_typestore(Stores.ROS2_JAZZY)
for _file in sorted(DEFINITIONS.glob("*.msg")):
    store.register(get_types_from_msg(_file.read_text(encoding="utf-8"), f"skd_msgs/msg/{_file.stem}"))


@dataclass(frozen=True)
class Sent:
    """A message on a topic: its content as rosbags has it, and when it was logged, ns."""

    topic: str
    content: Any
    time: int

    def bytes(self) -> bytes:
        return bytes(store.serialize_cdr(self.content, TYPES[base(self.topic)]))


def base(topic: str) -> str:
    return next(name for name in TYPES if topic.endswith(name))


def _new(name: str, **fields: Any) -> Any:
    return store.types[name](**fields)


def _stamp(nanoseconds: int) -> Any:
    return _new("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def _header(nanoseconds: int) -> Any:
    return _new("std_msgs/msg/Header", stamp=_stamp(nanoseconds), frame_id="map")


def _point(x: float, y: float) -> Any:
    return _new("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.0)


def _vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return _new("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))


def _odometry(stamp: int, frame: str, x: float, y: float, yaw: float, velocity: tuple[float, float]) -> Any:
    turn = _new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))
    pose = _new("geometry_msgs/msg/Pose", position=_point(x, y), orientation=turn)
    twist = _new("geometry_msgs/msg/Twist", linear=_vector(*velocity), angular=_vector())
    nothing = np.zeros(36)
    return _new(
        "nav_msgs/msg/Odometry",
        header=_header(stamp),
        child_frame_id=frame,
        pose=_new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=nothing),
        twist=_new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=nothing),
    )


def messages_of(log: EpisodeLog, campaign: str, start: int) -> list[Sent]:
    """Return what the graph says of an episode that starts at `start` (ns)."""
    spec, step = log.episode, log.episode.scenario.time_step
    phi = spec.safe_trajectory
    episode = _new(
        TYPES[EPISODE],
        header=_header(start),
        campaign=campaign,
        episode_id=spec.episode_id,
        seed=spec.seed,
        mode=int(spec.mode),
        controller=spec.controller,
        multiplier=spec.multiplier,
        scenario=json.dumps(spec.scenario.as_dict()),
        public_scenario="",
        car_model=spec.car_model,
        simulations=spec.simulations,
        objective=spec.objective.value,
        maximum_distance=spec.maximum_distance or 0.0,
        safe_trajectory_name="" if phi is None else phi.name,
        safe_trajectory_time_step=0.0 if phi is None else phi.time_step,
        safe_trajectory=[] if phi is None else [_point(*position) for position in phi.positions],
        options=options_to_text(spec),
        controller_seed=np.frombuffer(controller_seed(spec.seed, spec.episode_id), np.uint8),
    )
    sent = [Sent(EPISODE, episode, start)]
    stamp = start
    for tick, ((x, y), (car_x, car_y, heading, speed)) in enumerate(zip(log.adversary, log.car, strict=True)):
        stamp = tick_stamp(start, tick, step)
        sent.append(Sent(CAR, _odometry(stamp, "ego/base_link", car_x, car_y, heading, (speed, 0.0)), stamp))
        sent.append(Sent(ADVERSARY, _odometry(stamp, "adversary", x, y, 0.0, (0.0, 0.0)), stamp))
    commands = np.empty((0, 2)) if log.commands is None else log.commands
    result = _new(
        TYPES[RESULT],
        header=_header(stamp),
        campaign=campaign,
        episode_id=spec.episode_id,
        start=_stamp(start),
        outcome=int(log.outcome),
        ticks=len(log.adversary) - 1,
        impact_time=log.impact_time,
        impact_speed=log.impact_speed,
        reason=log.reason,
        commands_clipped=log.clipped,
        commands=[
            _new("geometry_msgs/msg/Accel", linear=_vector(ahead), angular=_vector(0.0, 0.0, steering))
            for ahead, steering in commands.tolist()
        ],
        command_ages=np.array(log.timing.ages, np.float32),
        commands_held=log.timing.held,
        greatest_delay=log.timing.delay,
    )
    return [*sent, Sent(RESULT, result, stamp)]


def campaign_messages(logs: Iterable[EpisodeLog], campaign: str = "campaign") -> list[list[Sent]]:
    """Return what the graph says of episodes that are run one after another, by episode."""
    start, episodes = 10**9, []
    for log in logs:
        episodes.append(messages_of(log, campaign, start))
        horizon = tick_stamp(start, log.episode.scenario.ticks, log.episode.scenario.time_step)
        start = next_start(horizon)
    return episodes


def write_mcap(
    path: Path,
    sent: Sequence[Sent],
    *,
    compression: CompressionType = CompressionType.NONE,
    chunk_size: int = 2**20,
    chunks: bool = True,
    checksums: bool = True,
    encode: Callable[[Sent], bytes] = Sent.bytes,
    metadata: dict[str, str] | None = None,
) -> Path:
    """Write messages in the order given, and return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(
            stream,
            chunk_size=chunk_size,
            compression=compression,
            use_chunking=chunks,
            enable_crcs=checksums,
            enable_data_crcs=checksums,
        )
        writer.start(profile="ros2", library="libmcap 1.1.0")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for sequence, message in enumerate(sent):
            name = TYPES[base(message.topic)]
            if name not in schemas:
                definition = store.generate_msgdef(name, ros_version=2)[0]
                schemas[name] = writer.register_schema(name, "ros2msg", definition.encode())
            if message.topic not in channels:
                said = metadata if metadata and message.topic.endswith(RESULT) else {}
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schemas[name], said)
            writer.add_message(channels[message.topic], message.time, encode(message), message.time, sequence)
        writer.finish()
    return path


def changed(content: Any, field: str, value: Any) -> Any:
    """Return a message with one field, named by its path, of another value."""
    name, _, rest = field.partition(".")
    if rest:
        value = changed(getattr(content, name), rest, value)
    return dataclasses.replace(content, **{name: value})


def forged(sent: Sequence[Sent], place: int, field: str, value: Any) -> list[Sent]:
    """Return messages of which one says something else."""
    content = changed(sent[place].content, field, value)
    return [*sent[:place], dataclasses.replace(sent[place], content=content), *sent[place + 1 :]]
