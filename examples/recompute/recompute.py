"""The figures of assessment.json, from the episodes.npz beside it, as docs/files.md says: run it in their folder."""
import numpy as np
from scipy.stats import binomtest, norm, sem
def couple(phi, psi, join, slant):  # the least cost of a coupling of two curves: Fréchet distance, time warping
    gap, way = np.linalg.norm(phi[:, None] - psi, axis=2), np.full((len(phi) + 1, len(psi) + 1), np.inf)
    way[0, 0] = 0.0
    for i, j in np.ndindex(gap.shape):
        way[i + 1, j + 1] = min(join(min(way[i, j + 1], way[i + 1, j]), gap[i, j]), join(way[i, j], slant * gap[i, j]))
    return way[-1, -1] / sum(gap.shape) ** (slant - 1)
def wilson(hits):
    return binomtest(int(hits.sum()), hits.size).proportion_ci(method="wilson") if hits.size else np.nan
a = dict(np.load("episodes.npz"))
hit, ran, index, along, most = a["outcome"] == 1, a["outcome"] != 5, a["safe_index"], a["mode"] == 2, a["eta_max"]
parts, d, found, z = np.split(a["positions"], a["offsets"][1:-1]), np.full((4, len(hit)), np.nan), {}, norm.ppf(0.975)
for k in np.flatnonzero((a["mode"] == 1) & hit):  # of each pair: Fréchet, prefix, deformation, warped
    phi, psi = parts[index[k]], np.vstack([parts[k][:-1], a["contact"][k]])
    cut, ticks = phi[: len(psi)], [*range(len(psi) - 1), a["impact_time"][k] / a["time_step"]]
    d[[0, 1, 3], k] = couple(phi, psi, max, 1), couple(cut, psi, max, 1), couple(cut, psi, np.add, 2)
    d[2, k] = max(np.hypot(*(to - np.interp(ticks, range(len(phi)), by) for by, to in zip(phi.T, psi.T, strict=True))))
needed, floor = np.where(hit, np.fmin(d[2], most), most), a.get("floor", d[0] * np.nan)
sets = [(f"objectives.{o}.", 2 * p, a["objective"] == o) for o, p in zip(a["objectives"], a["plans_deformation"])]
each = [(f"per_safe_trajectory.{i}.", index == i) for i in range(len(a["safe_name"]))]
for name, of, rows in sets + [(name + phi, of, rows & mine) for name, of, rows in sets for phi, mine in each]:
    tried, hits, kept = rows & ran, rows & hit, rows & hit & ~(d[of] > a["maximum_distance"])
    known, fair, stood = kept & (floor >= 0), (kept | tried & ~hit) & (of == 2), a["impact_speed"][hits] < 0.1
    n, r = known.sum() / max(floor[known].sum(), 1e-9), d[of][known].sum() / max(floor[known].sum(), 1e-9)
    x = {"deformation": needed[tried], "deformation_of_successes": d[2, hits], "skd": d[0, kept], "warped": d[3, kept],
         "skd_prefix": d[1, kept], "floor": floor[known], "floor_of_all": np.fmin(floor, most)[fair],
         "closeness": r + n * (d[of][known] - r * floor[known]), "mean_impact_speed": a["impact_speed"][hits]}
    y = {"attempts": tried.sum(), "failed": (tried & ~hit).sum(), "aborted": (rows & ~ran).sum(), "pairs": kept.sum(),
         "discarded_by_distance": hits.sum() - kept.sum(), "floor_missing": kept.sum() - known.sum(),
         "standing_contacts": stood.sum(), "success_rate": hit[tried].mean(), "success_rate_ci95_attempts": wilson(hit[tried])}
    y |= {key: one.mean() for key, one in x.items() if one.size}
    y |= {f"{key}_ci95{over.get(key, '')}": [y[key] + s * z * sem(one) for s in (-1, 1)] for key, one in x.items() if one.size > 1}
    v, m = x["skd"].var(ddof=1) if kept.sum() > 1 else np.nan, y.get("skd", 0.0)
    y |= {"variance": v} | {f"bound_{e:g}": min(1, (v + 2 * e * m) / (v + m * m)) for e in (0.25, 0.5, 1) if e < m}
    found |= {name + key: value for key, value in y.items()}
for n, on in [("", along & ran), *((phi, mine & along & ran) for phi, mine in each)]:
    found |= {f"{n}collision_rate": hit[on].mean(), f"{n}collision_rate_ci95_runs": wilson(hit[on]), f"{n}runs": on.sum()}
print(*(f"{name}: {value}" for name, value in found.items()), sep="\n")
