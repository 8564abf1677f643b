"""How hard the car would have had to brake in each pair: for a disc on the straight road, as docs/files.md says."""
import json
from pathlib import Path
import numpy as np
from intervals import layout
from recompute import a, d, each, parts, sets, touch
from scipy.stats import norm, sem, t
scenario = json.loads(Path("assessment.json").read_text())["scenario"]
car, user, step, braking = scenario["car"], scenario["adversary"], a["time_step"], {}
needed = np.full(len(touch), np.nan)
for k in np.flatnonzero(touch & (a["mode"] == 1)):
    (x, y), (_, place, speed) = parts[k].T, a["car"][a["offsets"][k] : a["offsets"][k + 1]].T
    ticks = np.arange(len(x)) * step < a["impact_time"][k]
    inside = np.flatnonzero(ticks & (np.abs(x) <= car["width"] / 2 + user["radius"]))
    if inside.size and (gap := y[i := inside[0]] - user["radius"] - place[i] - car["front"]) > 0:
        needed[k] = max(0, speed[i] - np.diff(y)[max(i, 1) - 1] / step) ** 2 / 2 / gap
for name, of, rows in sets:
    kept = rows & touch & ~(d[of] > a["maximum_distance"])
    of_phi = [needed[kept & mine & np.isfinite(needed)] for _, mine in each]
    values, key = np.concatenate(of_phi), f"{name}measures.required_deceleration_at_entry."
    braking |= {f"{key}pairs": values.size, f"{key}undefined": kept.sum() - values.size}
    if values.size > 1:
        half = norm.ppf(0.975) * sem(values)
        braking |= {f"{key}mean": values.mean(), f"{key}ci95_pairs": [values.mean() - half, values.mean() + half]}
    if sum(one.size > 0 for one in of_phi) > 1:
        said = layout(of_phi)[3]
        half = t.ppf(0.975, said["degrees_of_freedom"]) * said["standard_error"]
        braking[f"{key}ci95"] = [values.mean() - half, values.mean() + half]
print(*(f"{name}: {value}" for name, value in braking.items()), sep="\n")
