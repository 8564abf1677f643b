"""Figures for Foxglove: against shapely's distance of outlines, and the largest distance from φ at the same time."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from skd_adversary.adversary import BelievedCar
from skd_adversary.ros.adversary_node import belief_to_odometry
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.ros.visualization import recorded_figures
from skd_sim.ros.support import CLEARANCE, DEVIATION
from skd_sim.scenario.road import road_pose
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Outcome


def figures_of(log: EpisodeLog) -> tuple[list[float], list[float]]:
    """Clearance and deviation in a recording, m."""
    found: dict[str, list[float]] = {CLEARANCE: [], DEVIATION: []}
    for topic, message, _ in recorded_figures(log, 10**9):
        found[topic].append(message.data)
    return found[CLEARANCE], found[DEVIATION]


def test_figures_of_a_recording(expected: EpisodeLog, replay: EpisodeSpec) -> None:
    scenario, log = expected.episode.scenario, expected
    assert log.episode.safe_trajectory is not None
    apart, strayed = figures_of(log)
    assert len(apart) == len(strayed) == len(log.car)
    ends = -1 if log.outcome == Outcome.COLLISION else None
    for found, car, place in list(zip(apart, log.car, log.adversary, strict=True))[:ends]:
        half = scenario.car.half_width
        outline = shapely.box(car[0] - half, car[1] - scenario.car.rear, car[0] + half, car[1] + scenario.car.front)
        assert found == pytest.approx(max(0.0, outline.distance(shapely.Point(place)) - scenario.adversary.radius))
    if log.outcome == Outcome.COLLISION:
        assert apart[-1] == pytest.approx(0.0, abs=1e-6)
    phi = log.episode.safe_trajectory.positions
    held = phi[np.minimum(np.arange(len(log.adversary)), len(phi) - 1)]
    away = np.maximum.accumulate(np.hypot(*(log.adversary - held).T))
    assert strayed[:ends] == pytest.approx(away[:ends].tolist())
    along = figures_of(run_episode(replay))[1]
    assert along == pytest.approx([0.0] * len(along), abs=1e-9)


def test_a_belief_is_odometry_along_the_road(replay: EpisodeSpec) -> None:
    message = belief_to_odometry(BelievedCar(-7.0, 0.5, 6.0, 0.25), replay, 3_000_000_000)
    x, y, heading = road_pose(replay.scenario.road.line, -7.0)
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    assert (place.x, place.y, 2.0 * math.atan2(turn.z, turn.w)) == pytest.approx((x, y, heading))
    assert message.header.frame_id == "map"
    assert message.twist.twist.linear.x == 6.0
    covariance = np.array(message.pose.covariance).reshape(6, 6)
    assert np.linalg.eigvalsh(covariance)[-1] == pytest.approx(0.25)
    assert covariance[1, 1] == pytest.approx(0.25)  # the road leads North
    assert message.twist.covariance[0] == pytest.approx(0.0625)
