"""When a disc touches the car, how near it comes, and when a quantity is above 0: what surrogate.py goes on from."""
import json
from pathlib import Path
import numpy as np
scenario = json.loads(Path("assessment.json").read_text())["scenario"]
front, rear, half = scenario["car"]["front"], scenario["car"]["rear"], scenario["car"]["width"] / 2
radius, low, high = scenario["adversary"]["radius"], np.array([-half, -rear]), np.array([half, front])
corners = [np.array([x, y]) for x in (low[0], high[0]) for y in (low[1], high[1])]
def spans(t, depth):  # in which it is above 0
    cuts = [t[i] + (t[i + 1] - t[i]) * depth[i] / (depth[i] - depth[i + 1]) for i in np.flatnonzero(np.diff(depth > 0))]
    ends = [*t[:1][depth[:1] > 0], *cuts, *t[-1:][depth[-1:] > 0]]
    return list(zip(ends[::2], ends[1::2]))
def soonest(p, v):  # when a disc at p that moves with v (n × 2, seen from the car) touches: boxes, and discs at corners
    v, first = np.where(v == 0, 1e-300, v), [np.full(len(p), np.inf)]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        for grown in ((radius, 0), (0, radius)):
            t = np.sort([(low - grown - p) / v, (high + grown - p) / v], axis=0)
            first += [np.where((enter := t[0].max(1).clip(0)) <= t[1].min(1), enter, np.inf)]
        for q in [p - corner for corner in corners]:
            b, c, w = (q * v).sum(1), (q * q).sum(1) - radius**2, (v * v).sum(1)
            root = np.where((b < 0) & (b * b >= w * c), (-b - np.sqrt((b * b - w * c).clip(0))) / w, np.inf)
            first += [np.where(c <= 0, 0, root)]
    return np.where((found := np.min(first, axis=0)) <= 20, found, np.inf)
def nearest(p):  # of a disc whose centre goes through p: an end is nearest, or one of the car's corners
    found = np.hypot(*np.maximum(0, np.maximum(low - p, p - high)).T).min()
    for before, way in zip(p[:-1], np.diff(p, axis=0)):
        for corner in corners:
            share = np.clip((corner - before) @ way / max(way @ way, 1e-300), 0, 1)
            found = min(found, np.hypot(*(before + share * way - corner)))
    return max(0.0, found - radius)
