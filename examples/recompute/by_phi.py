"""The figures by φ of assessment.json: run it as recompute.py, which it goes on from."""
import numpy as np
from bounds import bound
from intervals import layout, of_distance, of_rate
from recompute import a, along, d, each, hit, most, needed, parts, ran, sets, touch
SPREAD = {"deviation": (0.02, 3.0), "skd": (0.02, 3.0), "skd_prefix": (0.04, 1.5), "warped": (0.04, 1.5)}
by_phi = {}
def groups(values, rows):
    return [np.asarray(values, float)[rows & mine] for _, mine in each]
def put(name, key, values, interval):
    if sum(one.size > 0 for one in values):
        by_phi.update({f"{name}clustering.{key}.{what}": value for what, value in layout(values)[3].items()})
    if sum(one.size > 0 for one in values) > 1:
        by_phi[f"{name}{key}_ci95"] = interval(values)
closing = np.full(len(touch), np.nan)  # the car's speed relative to the adversary's; a straight road leads North
for k in np.flatnonzero(touch):
    closing[k] = np.hypot(*(np.diff(parts[k][-2:], axis=0)[0] / a["time_step"] - (0.0, a["impact_speed"][k])))
for name, of, rows in sets:
    tried, kept = rows & ran, rows & touch & ~(d[of] > a["maximum_distance"])
    figures = {"deviation": (needed, tried, most), "skd": (d[0], kept, np.inf), "skd_prefix": (d[1], kept, np.inf)}
    for key, (values, mine, high) in (figures | {"warped": (d[3], kept, np.inf)}).items():
        low = -np.inf if key == "warped" else 0.0
        put(name, key, groups(values, mine), lambda one, ends=(*SPREAD[key], low, high): of_distance(one, *ends))
    by_phi[f"{name}mean_closing_speed"] = closing[rows & touch].mean() if (rows & touch).any() else np.nan
    put(name, "success_rate", groups(hit if of == 2 else touch, tried), of_rate)
    parts, pairs = groups(d[0], kept), d[0][kept]
    for eta in (0.25, 0.5, 1.0):
        if pairs.size > 1 and eta < pairs.mean() and sum(one.size > 0 for one in parts) > 1:
            m, square, value = pairs.mean(), pairs.var(ddof=1) + pairs.mean() ** 2, bound(eta, pairs)
            slopes = -2 * (m - eta) / square, (m * m - 2 * eta * m) / square**2
            moved = [slopes[0] * (one - m) + slopes[1] * (one**2 - square) for one in parts]
            ends, mean = of_distance(moved, *SPREAD["skd"], side=-1), np.concatenate(moved).mean()
            by_phi[f"{name}bound_{eta:g}_ci95"] = np.clip(value + ends - mean, 0, 1)
put("", "contact_rate", groups(touch, along & ran), of_rate)
by_phi["collision_standing_contacts"] = (a["impact_speed"][along & touch] < 0.1).sum()
print(*(f"{name}: {value}" for name, value in by_phi.items()), sep="\n")
