"""What only the simulator may say: whether it alone says it, and whether what it says can have happened."""

from __future__ import annotations

from rclpy.node import Node
from skd_sim.aborts import AbortKind, abort_reason
from skd_sim.episode import EpisodeLog, Outcome
from skd_sim.nodes.publishers import living_publishers
from skd_sim.nodes.support import EGO_ODOMETRY, EPISODE_RESULT, PEDESTRIAN_ODOMETRY

from skd_evaluator.errors import AssessmentError
from skd_evaluator.validation import examine

STATES = (EGO_ODOMETRY, PEDESTRIAN_ODOMETRY)


def require_one_simulator(node: Node) -> None:
    """Refuse a graph in which two nodes publish states.

    Raises:
        AssessmentError: with their names.
    """
    for topic in STATES:
        if node.count_publishers(node.resolve_topic_name(topic)) < 2:
            continue
        names = living_publishers(node, topic)
        if len(names) > 1:
            raise AssessmentError(
                f"{len(names)} nodes publish {node.resolve_topic_name(topic)}, which is the simulator's alone: "
                f"{' and '.join(names)}; end all but one"
            )


def foreign_sender(node: Node) -> str | None:
    """Return, as the reason of an abort, who else than the simulator publishes results; none where nobody does."""
    topic = node.resolve_topic_name(EPISODE_RESULT)
    names = living_publishers(node, EPISODE_RESULT)
    if len(names) > 1:
        return abort_reason(
            AbortKind.SECOND_SENDER,
            f"{len(names)} nodes publish {topic}, which is the simulator's alone: {' and '.join(names)}",
        )
    simulator = living_publishers(node, EGO_ODOMETRY)
    if names and len(simulator) == 1 and names != simulator:
        return abort_reason(
            AbortKind.SECOND_SENDER, f"{names[0]} publishes {topic}, which is for the simulator, {simulator[0]}"
        )
    return None


def refuted(log: EpisodeLog, *, own_world: bool) -> str | None:
    """Return, as the reason of an abort, why an episode cannot have happened as it is said to; none where it can.

    Args:
        log: of the episode.
        own_world: it ran in SKD's own world, so all that follows from its seed has to agree.
    """
    if log.outcome == Outcome.ABORTED:
        return None
    verdict = examine(log)
    if verdict.fault:
        return abort_reason(AbortKind.REFUTED, f"the episode {verdict.fault}")
    if own_world and not verdict.ours:
        return abort_reason(
            AbortKind.REFUTED,
            f"{verdict.where} does not follow from the episode's other states (by {verdict.deviation:.3g})",
        )
    return None
