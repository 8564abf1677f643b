"""What only the simulator may say: whether it alone says it, and whether what it says can have happened."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from skd_sim.choices.simulators import is_own_world
from skd_sim.episode.aborts import AbortKind, abort_reason
from skd_sim.episode.episode import EpisodeLog, Outcome
from skd_sim.episode.stamps import NANOSECONDS
from skd_sim.nodes.publishers import living_publishers, publisher_names

from skd_evaluator.bags.validation import examine
from skd_evaluator.errors import AssessmentError


class OneSimulator:
    """Looks who else speaks on the simulator's topics; cheap as long as nobody does."""

    def __init__(self, node: Node, states: Sequence[Any], results: Any) -> None:
        """Watch subscriptions of a node.

        Args:
            node: node that has the subscriptions.
            states: subscriptions to the topics of states.
            results: subscription to the topic of results.
        """
        self._node = node
        self._states = states
        self._results = results
        self._known = False  # the one who publishes results is the simulator

    def require(self) -> None:
        """Refuse a graph in which two nodes publish states.

        Raises:
            AssessmentError: with their names.
        """
        for subscription in self._states:
            topic = subscription.topic_name
            if subscription.get_publisher_count() > 1 and len(living_publishers(self._node, topic)) > 1:
                names = publisher_names(self._node, topic, least=2)
                raise AssessmentError(
                    f"{len(names)} nodes publish {topic}, which is the simulator's alone: "
                    f"{' and '.join(names)}; end all but one"
                )

    def contradiction(self, whose: str, topic: str, at: int) -> AssessmentError:
        """Return what is wrong where two different states came, `at` ns after the begin of the episode.

        Raises:
            AssessmentError: two nodes publish them, who are named.
        """
        self.require()
        return AssessmentError(
            f"two different states of the {whose} came for {at / NANOSECONDS:.3f} s of the episode: another node, "
            f"which is gone, has published {self._node.resolve_topic_name(topic)}, or the simulator contradicts itself"
        )

    def foreign_sender(self) -> str | None:
        """Return, as the reason of an abort, who else publishes results; none where only the simulator does."""
        one = self._results.get_publisher_count() == 1
        if one and self._known:
            return None
        topic = self._results.topic_name
        said = living_publishers(self._node, topic)
        simulator = living_publishers(self._node, self._states[0].topic_name)
        alone = len(said) == 1 and len(simulator) == 1 and said[0].same_node(simulator[0])
        self._known = one and alone and said[0].named and simulator[0].named
        if len(said) > 1:
            names = publisher_names(self._node, topic, least=2)
            return abort_reason(
                AbortKind.SECOND_SENDER,
                f"{len(names)} nodes publish {topic}, which is the simulator's alone: {' and '.join(names)}",
            )
        if said and len(simulator) == 1 and not alone:
            names = [*publisher_names(self._node, topic), *publisher_names(self._node, self._states[0].topic_name)]
            return abort_reason(
                AbortKind.SECOND_SENDER, f"{names[0]} publishes {topic}, which is for the simulator, {names[-1]}"
            )
        return None


def refuted(log: EpisodeLog, *, own_world: bool) -> str | None:
    """Return, as the reason of an abort, why an episode cannot have happened as it is said to; none where it can.

    Args:
        log: what is said to have happened in the episode.
        own_world: whether SKD started the simulator; where the episode asks for SKD's own world, all that follows from
            its seed then has to agree.
    """
    if log.outcome == Outcome.ABORTED:
        return None
    verdict = examine(log)
    if verdict.fault:
        return abort_reason(AbortKind.REFUTED, f"the episode {verdict.fault}")
    if own_world and is_own_world(log.episode.simulator) and not verdict.ours:
        return abort_reason(
            AbortKind.REFUTED,
            f"{verdict.where} does not follow from the episode's other states (by {verdict.deviation:.3g})",
        )
    return None
