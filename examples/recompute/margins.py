"""The margin of assessment.json, from the ways that episodes.npz has: run it as recompute.py, which it goes on from."""
import numpy as np
from by_phi import groups
from intervals import of_distance, of_rate
from recompute import a, along, each, hit, most, needed, parts, ran, sets
from scipy.stats import norm
margins, of_phi, trial = np.full(len(a["margin"]), float(most)), a["margin_safe_index"], a["margin_trial"]
for k in np.flatnonzero(a["margin"] >= 0):  # of each way: how far from φ at ticks and at the contact
    phi, psi = parts[of_phi[k]], a["margin_positions"][a["margin_offsets"][k] : a["margin_offsets"][k + 1]]
    ticks = [*range(len(psi) - 1), a["margin_duration"][k]]
    apart = [to - np.interp(ticks, range(len(phi)), by) for by, to in zip(phi.T, psi.T, strict=True)]
    margins[k] = min(np.hypot(*apart).max(), most)
per_phi, found = [margins[of_phi == i] for i in range(len(each))], np.isfinite(a["margin"])
gap, speeds = np.where(found, a["margin_gap"], 0.0).mean(), a["margin_impact_speed"][found]
margin = {"margin": margins.mean(), "margin_ci95": of_distance(per_phi, 0.02, 3.0, 0.0, most, tail=0.6)}
margin |= {"margin_gap": gap if gap < np.inf else np.nan, "margin_trials": margins.size}
margin |= {"margin_beyond": (~found).sum(), "margin_p10": np.quantile(margins, 0.1)}
margin |= {"impact_speed.mean": speeds.mean(), "impact_speed.p90": np.quantile(speeds, 0.9)} if speeds.size else {}
runs = groups(hit, along & ran)
margin |= {"nominal_collision_rate": np.concatenate(runs).mean(), "nominal_collision_rate_ci95": of_rate(runs)}
rows = ([rows for name, _, rows in sets if name == "objectives.deviation."] or [sets[0][2]])[0] & ran
planned, least = [], []  # optimality gap: planned over margin, of the trials that both have
for i, (_, mine) in enumerate(each):
    number = a["episode_id"][rows & mine] & 0xFFFFFFFF
    by_number = dict(zip(trial[of_phi == i].tolist(), per_phi[i], strict=True))
    both = [(one, by_number[n]) for n, one in zip(number.tolist(), needed[rows & mine], strict=True) if n in by_number]
    planned, least = [*planned, [one for one, _ in both]], [*least, [one for _, one in both]]
if sum(map(sum, least)) > 1e-9:
    margin["optimality_gap"] = sum(map(sum, planned)) / sum(map(sum, least))
    x, y = (np.array([np.mean(one) for one in side if one]) for side in (planned, least))
    r, half = x.mean() / y.mean(), norm.ppf(0.975) / np.sqrt(len(x))
    half *= np.std(x - x.mean() / y.mean() * y, ddof=1) / y.mean()
    margin["optimality_gap_ci95"] = [r - half, r + half]
print(*(f"{name}: {value}" for name, value in margin.items()), sep="\n")
