"""The figures of assessment.json, from the episodes.npz beside it, as docs/files.md says: run it in their folder."""
import numpy as np
from coupling import couple
from scipy.stats import binomtest, norm, sem
def wilson(hits):
    return binomtest(int(hits.sum()), hits.size).proportion_ci(method="wilson") if hits.size else np.nan
a = dict(np.load("episodes.npz"))
over = {"deviation": "_trials", "skd": "_pairs", "skd_prefix": "_pairs", "warped": "_pairs"}
touch, ran, index, along, most = a["outcome"] == 1, a["outcome"] != 5, a["safe_index"], a["mode"] == 2, a["eta_max"]
hit = touch & (np.nan_to_num(a["impact_speed"], nan=-1.0) >= a["hit_speed"])  # by the moving car
parts, d, found, z = np.split(a["positions"], a["offsets"][1:-1]), np.full((4, len(hit)), np.nan), {}, norm.ppf(0.975)
for k in np.flatnonzero((a["mode"] == 1) & touch):  # of each pair: Fréchet, prefix, deviation, warped
    phi, psi = parts[index[k]], np.vstack([parts[k][:-1], a["contact"][k]])
    cut, ticks = phi[: len(psi)], [*range(len(psi) - 1), a["impact_time"][k] / a["time_step"]]
    d[[0, 1, 3], k] = couple(phi, psi, max, 1), couple(cut, psi, max, 1), couple(cut, psi, np.add, 2)
    d[2, k] = max(np.hypot(*(to - np.interp(ticks, range(len(phi)), by) for by, to in zip(phi.T, psi.T, strict=True))))
needed = np.where(hit, np.fmin(d[2], most), most)
sets = [(f"objectives.{o}.", 2 * p, a["objective"] == o) for o, p in zip(a["objectives"], a["plans_deviation"])]
each = [(f"per_safe_trajectory.{i}.", index == i) for i in range(len(a["safe_name"]))]
for name, of, rows in sets + [(name + phi, of, rows & mine) for name, of, rows in sets for phi, mine in each]:
    tried, hits, kept = rows & ran, rows & touch, rows & touch & ~(d[of] > a["maximum_distance"])
    reached, speeds = hit if of == 2 else touch, a["impact_speed"][hits]
    x = {"deviation": needed[tried], "deviation_of_successes": d[2, rows & hit], "skd": d[0, kept],
         "warped": d[3, kept], "skd_prefix": d[1, kept], "mean_impact_speed": speeds}
    y = {"trials": tried.sum(), "failed": (tried & ~reached).sum(), "aborted": (rows & ~ran).sum(),
         "pairs": kept.sum(), "discarded_by_distance": (hits & ~kept).sum(), "standing_contacts": (speeds < 0.1).sum(),
         "success_rate": reached[tried].mean(), "success_rate_ci95_trials": wilson(reached[tried])}
    y |= {key: one.mean() for key, one in x.items() if one.size}
    ends = {key: [y[key] + side * z * sem(one) for side in (-1, 1)] for key, one in x.items() if one.size > 1}
    y |= {f"{key}_ci95{over.get(key, '')}": one for key, one in ends.items()}
    v, m = x["skd"].var(ddof=1) if kept.sum() > 1 else np.nan, y.get("skd", 0.0)
    y |= {"variance": v} | {f"bound_{e:g}": min(1, (v + 2 * e * m) / (v + m * m)) for e in (0.25, 0.5, 1) if e < m}
    found |= {name + key: value for key, value in y.items()}
for n, on in [("", along & ran), *((phi, mine & along & ran) for phi, mine in each)]:
    found |= {f"{n}contact_rate": touch[on].mean(), f"{n}runs": on.sum()}
    found[f"{n}contact_rate_ci95_runs"] = wilson(touch[on])
print(*(f"{name}: {value}" for name, value in found.items()), sep="\n")
