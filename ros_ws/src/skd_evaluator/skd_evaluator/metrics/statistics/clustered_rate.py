"""Rates over few safe trajectories, each with a rate of its own: Wilson's interval with an effective number of runs.

Runs along one φ are more alike than runs along several. How much less they say is found from how the φ differ: the
squared error of the rate, by φ (`cluster_error`), is that of an effective number of independent runs, p·(1 − p) over
it. Wilson's score interval with that number and with Student's quantile stays in [0, 1] and holds for rates near its
ends, where an interval to both sides of the rate does not (Dean and Pagano, Journal of Survey Statistics and
Methodology 3, 2015; Franco, Little, Louis and Slud, ibid. 7, 2019).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from skd_evaluator.metrics.statistics.clustered import (
    SUSPICIOUS,
    Clustered,
    cluster_error,
    components_of,
    group_notes,
    student_quantile,
)
from skd_evaluator.metrics.statistics.statistics import checked_confidence, score_interval


def clustered_rate(counts: Sequence[tuple[int, int]], confidence: float = 0.95) -> Clustered | None:
    """Return the share of hits among all trials with its interval over groups.

    Args:
        counts: hits and trials of each φ; a φ without trials does not count.
        confidence: two-sided, in (0, 1).

    Returns:
        None without a trial. One group has no interval.

    Raises:
        ValueError: counts that contradict each other, or a confidence outside (0, 1).
    """
    checked_confidence(confidence)
    for hits, runs in counts:
        if not 0 <= hits <= runs:
            raise ValueError(f"hits must be from 0 to the number of trials, got {hits} of {runs}")
    filled = np.array([one for one in counts if one[1] > 0], dtype=np.float64).reshape(-1, 2)
    if not len(filled):
        return None
    trials = filled[:, 1]
    rates = filled[:, 0] / trials
    total, every = int(filled[:, 0].sum()), int(trials.sum())
    rate = total / every
    components = components_of(rates, trials, math.fsum(trials * rates * (1.0 - rates)))
    error, freedom = cluster_error(rates, trials, components)
    notes = group_notes(len(filled), len(counts))
    interval = None
    if error is not None and freedom is not None:
        spread = rate * (1.0 - rate)
        effective = spread / error**2 if error > 0.0 else float(every)
        interval = score_interval(rate, effective, student_quantile(freedom, confidence))
        if total in (0, every):
            notes.append(f"{'none' if total == 0 else 'all'} of {every}: the interval takes them as independent")
        elif error == 0.0:
            notes.append("all φ have the same rate: the interval takes the runs as independent")
        elif effective > SUSPICIOUS * every:
            notes.append("the φ agree more than chance within them lets expect: the interval is narrow by luck")
    return Clustered(rate, interval, error, freedom, len(filled), every, components, tuple(notes))
