"""The vulnerability curve of assessment.json, and the floors' where there is one: run it as recompute.py."""
import numpy as np
from by_phi import groups
from intervals import bound, of_rate
from recompute import floor, most, needed, ran, sets, wilson
curve, rows = {}, ([rows for name, _, rows in sets if name == "objectives.deformation."] or [sets[0][2]])[0] & ran
for name, values, mine in (("kamikazes", needed, rows), ("floors", np.fmin(floor, most), rows & (floor >= 0))):
    values = np.where(values <= 1e-10, 0.0, values)
    etas, counts = np.unique(values[mine & (values < most)], return_counts=True)
    curve[f"{name}.steps.eta"], curve[f"{name}.steps.probability"] = etas, np.cumsum(counts) / max(1, mine.sum())
    curve |= {f"{name}.attempts": mine.sum(), f"{name}.area_above": values[mine].sum() / max(1, mine.sum())}
    for number, eta in enumerate(np.linspace(0, most, 50, endpoint=False) if mine.any() else ()):
        on, parts = values <= eta, groups(values <= eta, mine)
        point = {"eta": eta, "probability": on[mine].mean(), "ci95_attempts": wilson(on[mine])}
        point["bound"] = bound(eta, values[mine])
        spread, gap = values[mine].var(ddof=1) if mine.sum() > 1 else np.nan, values[mine].mean() - eta
        point["cantelli"] = spread / (spread + gap**2) if gap > 0 and spread >= 0 else 1.0
        point["ci95"] = of_rate(parts) if sum(one.size > 0 for one in parts) > 1 else np.nan
        curve |= {f"{name}.points.{number}.{key}": value for key, value in point.items()}
print(*(f"vulnerability_curve.{name}: {value}" for name, value in curve.items()), sep="\n")
