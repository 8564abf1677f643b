"""Surrogate safety measures, median and worst of a pedestrian on the straight road, as docs/metrics.md defines them."""
import numpy as np
from recompute import a, parts, ran, touch
from touching import front, half, nearest, radius, rear, scenario, soonest, spans
step, rows, surrogate = float(a["time_step"]), {}, {}
for k in np.flatnonzero(ran & (a["mode"] > 0)):
    walk, (at, speed) = parts[k].copy(), a["car"][a["offsets"][k] : a["offsets"][k + 1], 1:].T.copy()
    t = np.arange(len(walk)) * step
    if touch[k]:
        share, t[-1], walk[-1] = a["impact_time"][k] / step - len(t) + 2, a["impact_time"][k], a["contact"][k]
        at[-1], speed[-1] = (one[-2] + share * (one[-1] - one[-2]) for one in (at, speed))
    v, p = np.diff(walk, axis=0) / np.diff(t)[:, None], walk - np.column_stack([0 * at, at])
    fine = np.append(np.arange(0, t[-1], 0.05), t[-1])
    x, y, now = (np.interp(fine, t, one) for one in (*p.T, speed))
    w = v[(np.searchsorted(t, fine, "right") - 1).clip(0, len(v) - 1)] - np.column_stack([0 * now, now])
    soon, gap = soonest(np.column_stack([x, y]), w), y - radius - front
    ahead = (gap >= -1e-6) & (np.abs(x) - radius < half) & (now > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        brake = np.where((soon <= 20) & (w[:, 1] < 0) & (gap >= -1e-6), w[:, 1] ** 2 / 2 / gap.clip(0), 0)
        brake, behind = brake.max().clip(0, 9.81), np.where(ahead, gap.clip(0) / now, np.inf).min()
    inside, after = spans(t, half + radius - np.abs(walk[:, 0])), np.nan
    if inside:
        ends = [inside[0][0], inside[-1][1]]
        there = [*walk[(t >= ends[0]) & (t <= ends[1]), 1], *np.interp(ends, t, walk[:, 1])]
        come, gone = spans(t, at + front - min(there) + radius), spans(t, max(there) + radius - at + rear)
        if come and gone and come[0][0] < gone[0][1]:
            after = min(max(0.0, one[0] - gone[0][1], come[0][0] - one[1]) for one in inside)
    hit = np.hypot(v[-1][0], v[-1][1] - speed[-1]) if touch[k] else np.nan
    rows[k] = {"clearance": 0.0 if touch[k] else nearest(p), "time_to_collision": 0.0 if touch[k] else soon.min(),
               "post_encroachment_time": 0.0 if touch[k] else after, "headway": behind, "required_deceleration": brake,
               "brake_threat_number": brake / scenario["car"]["deceleration"], "closing_speed": hit,
               "delta_v": hit * 1500 / 1578, "fatality_risk": 1 / (1 + 1.11 ** (59 - 3.6 * hit))}
for name, mode, objective in [("along_phi", 2, ""), *((f"kamikazes.{one}", 1, one) for one in a["objectives"])]:
    mine = [one for k, one in rows.items() if a["mode"][k] == mode and a["objective"][k] == objective]
    surrogate[f"surrogate_measures.{name}.episodes"] = len(mine)
    for place, key in enumerate(rows[next(iter(rows))]):
        known, start = [one[key] for one in mine if np.isfinite(one[key])], f"surrogate_measures.{name}.{key}."
        surrogate |= {f"{start}defined": len(known), f"{start}median": np.median(known) if known else np.nan}
        surrogate[f"{start}worst"] = (min if place < 4 else max)(known, default=np.nan)
print(*(f"{name}: {value}" for name, value in surrogate.items()), sep="\n")
