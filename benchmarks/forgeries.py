"""Ways to forge a whole recording so that its messages still agree with each other; see `mutations.py`.

Those of which episodes there are stand here, those of what they are said to be in `spec_forgeries.py`, of what happened
in them in `state_forgeries.py`, and of episodes that are true and of another campaign in `mixed_forgeries.py`. Beside
these stand recorders that are odd and honest (`recorders.py`, `foreign_recorders.py`): they are to change no number.
Each has the signature of a `mutators.Mutator`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mixed_forgeries
import numpy as np
import spec_forgeries
import state_forgeries
from bag_forge import ADVERSARY, CAR, EPISODE, RESULT, Sent, changed, write_mcap
from forging import Forgery, each, episode_of
from mutators import Mutator, pick
from recorders import odd_chunks, odd_records


def aborted(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    _, end = episode_of(sent, rng)
    content = sent[end].content
    for field, value in (("outcome", 5), ("reason", "no command"), ("impact_time", 0.0), ("impact_speed", 0.0)):
        content = changed(content, field, value)
    return [*sent[:end], dataclasses.replace(sent[end], content=content), *sent[end + 1 :]], "an episode called aborted"


def ended_before(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    first, end = episode_of(sent, rng)
    states = [one for one in sent[first + 1 : end] if one.topic in (CAR, ADVERSARY)]
    ticks = max(1, len(states) // 2 - 1 - int(rng.integers(1, 3)))
    content = sent[end].content
    outcome = int(pick(rng, [1, 2, 3, 4]))
    for field, value in (("outcome", outcome), ("ticks", ticks), ("impact_time", 0.0), ("impact_speed", 0.0)):
        content = changed(content, field, value)
    result = dataclasses.replace(sent[end], content=content)
    return [*sent[: first + 1], *states[: 2 * (ticks + 1)], result, *sent[end + 1 :]], f"over after {ticks}: {outcome}"


def _kind_of(one: Sent) -> tuple[Any, ...]:
    return one.content.mode, one.content.safe_trajectory_name


def without(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Drop an episode whole that another attempt of its kind follows: specification, states and result."""
    places = [place for place, one in enumerate(sent) if one.topic == EPISODE]
    followed = [
        place
        for place in places
        if any(_kind_of(sent[other]) == _kind_of(sent[place]) for other in places if other > place)
    ]
    return _dropped(sent, pick(rng, followed or places[:1]))


def without_last(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Drop the last episode of all."""
    return _dropped(sent, max(place for place, one in enumerate(sent) if one.topic == EPISODE))


def _dropped(sent: list[Sent], first: int) -> tuple[list[Sent], str]:
    end = next(place for place in range(first, len(sent)) if sent[place].topic == RESULT)
    return [*sent[:first], *sent[end + 1 :]], f"the episode at {first} left out"


def run_twice(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Add an episode again under the name of another campaign."""
    first, end = episode_of(sent, rng)
    again = each(sent[first : end + 1], [EPISODE, RESULT], lambda one: changed(one, "campaign", "another"))
    return [*sent, *again], f"the episode at {first} in two campaigns"


def doubled_under_new_numbers(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Add an episode again as the next attempt of its kind, later."""
    first, end = episode_of(sent, rng)
    ids = {one.content.episode_id for one in sent if one.topic == EPISODE}
    new = next(number for number in range(int(sent[first].content.episode_id), 2**63) if number not in ids)
    shift = 10**9 * (2 + sent[-1].content.header.stamp.sec)

    def later(stamp: Any) -> Any:
        return changed(stamp, "sec", stamp.sec + shift // 10**9)

    def edit(one: Any) -> Any:
        one = changed(one, "header", changed(one.header, "stamp", later(one.header.stamp)))
        one = changed(one, "start", later(one.start)) if hasattr(one, "start") else one
        return changed(one, "episode_id", new) if hasattr(one, "episode_id") else one

    again = each(sent[first : end + 1], [EPISODE, CAR, ADVERSARY, RESULT], edit)
    return [*sent, *again], f"the episode at {first} again as number {new}"


def two_sessions(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Glue a second session behind the first: the same, another seed's or campaign's; its clock begins anew."""
    how = pick(rng, ["the same", "another seed", "another campaign", "another campaign without its last episode"])
    second = list(sent)
    if how == "another seed":
        second = each(second, [EPISODE], lambda one: changed(one, "seed", int(one.seed) + 1))
    elif how != "the same":
        second = each(second, [EPISODE, RESULT], lambda one: changed(one, "campaign", "second"))
        if how.endswith("episode"):
            second, _ = without_last(second, rng)
    return [*sent, *second], f"glued: {how}"


def cut_and_closed(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Cut anywhere, and close the file as if it had ended there, as a tool that repairs files does."""
    keep = int(rng.integers(1, len(sent)))
    return sent[:keep], f"cut after {keep} of {len(sent)} messages, and closed"


FORGERIES: dict[str, Forgery] = {
    "another seed": spec_forgeries.another_seed,
    "another multiplier": spec_forgeries.another_car,
    "another scenario": spec_forgeries.another_scenario,
    "another φ": spec_forgeries.another_phi,
    "another objective": spec_forgeries.another_objective,
    "simulations of all": spec_forgeries.fewer_simulations,
    "called aborted": aborted,
    "over before": ended_before,
    "another contact": state_forgeries.later_contact,
    "another place": state_forgeries.moved_world,
    "states of another": state_forgeries.another_walk,
    "rounded states": state_forgeries.rounded,
    "left out": without,
    "the last left out": without_last,
    "in two campaigns": run_twice,
    "another number": spec_forgeries.renumbered,
    "another clock": state_forgeries.other_clock,
    "another namespace": spec_forgeries.namespaced,
    "one topic a tick off": state_forgeries.shifted_topic,
    "other stamps": state_forgeries.other_stamps,
    "single precision": state_forgeries.single_precision,
    "left and right exchanged": state_forgeries.mirrored,
    "φ exchanged": spec_forgeries.exchanged_phi,
    "doubled under new numbers": doubled_under_new_numbers,
    "two sessions glued": two_sessions,
    "another car's states": state_forgeries.slower_car,
    "a weaker kamikaze's states": state_forgeries.weaker_kamikaze,
    "a miss instead": state_forgeries.missed_instead,
    "half the time step": state_forgeries.half_steps,
    "cut and closed": cut_and_closed,
    "an episode of another campaign": mixed_forgeries.one_of_another_campaign,
    "the best of several seeds": mixed_forgeries.all_of_several_seeds,
    "an episode of another kind": mixed_forgeries.of_the_other_kind,
    "attempts exchanged": mixed_forgeries.attempts_exchanged,
    "a φ left out": mixed_forgeries.phi_left_out,
    "another value at the top": mixed_forgeries.another_top_value,
    "another option": mixed_forgeries.another_option,
    "contacts rounded": mixed_forgeries.contact_rounded,
    "all hits aborted": mixed_forgeries.all_hits_aborted,
}

FOUND_OTHERWISE: dict[str, str] = {
    "another objective": "`--verify`",
    "another scenario": "`--verify`, where only plans follow from the value",
    "simulations of all": "`--verify`",
    "another multiplier": "nothing, where that car would have done the same in every episode",
    "another value at the top": "`--verify`, where only plans follow from the value",
    "another option": "nothing: a maximum distance, by which nobody plans, is one that the result states",
    "cut and closed": "the manifest, or assessment.json beside the bags, where whole φ come after the cut",
    "a φ left out": "the manifest, or assessment.json beside the bags, where it is the last φ",
    "the last left out": "the manifest, or assessment.json beside the bags",
    "one topic a tick off": "`--verify`, where a kamikaze that waits for a tick meets the car all the same",
    "a weaker kamikaze's states": "`--verify`",
    "another car's states": "`--verify`, where that car would have done the same, and only the plans differ",
}
"""Consistent forgeries that replay alone does not find, and what finds them."""
OF_SEVERAL = ("left out", "the last left out", "φ exchanged", "attempts exchanged", "a φ left out")
"""What is done to recordings of several episodes alone."""


def _mutator(forgery: Forgery) -> Mutator:
    def mutate(
        _original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator
    ) -> str:
        new, what = forgery(list(sent), rng)
        write_mcap(file, new, **options)
        return what

    return mutate


FORGING: dict[str, Mutator] = {
    **{name: _mutator(forgery) for name, forgery in FORGERIES.items()},
    "odd chunks": odd_chunks,
    "odd records": odd_records,
}
"""Of recordings."""
