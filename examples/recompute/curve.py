"""The vulnerability curves of assessment.json, of margins and of planned kamikazes: run it as recompute.py."""
import numpy as np
from bounds import bound, cantelli
from by_phi import groups
from intervals import of_rate
from margins import per_phi
from recompute import most, needed, ran, sets, wilson
curve, rows = {}, ([rows for name, _, rows in sets if name == "objectives.deviation."] or [sets[0][2]])[0] & ran
for name, parts in (("margins", per_phi), ("kamikazes", groups(needed, rows))):
    parts = [np.where(one <= 1e-10, 0.0, one) for one in parts]
    values = np.concatenate(parts)
    etas, counts = np.unique(values[values < most], return_counts=True)
    curve[f"{name}.steps.eta"], curve[f"{name}.steps.probability"] = etas, np.cumsum(counts) / max(1, values.size)
    curve |= {f"{name}.trials": values.size, f"{name}.area_above": values.mean() if values.size else 0.0}
    for number, eta in enumerate(np.linspace(0, most, 50, endpoint=False) if values.size else ()):
        on = [one <= eta for one in parts]
        point = {"eta": eta, "probability": np.mean(values <= eta), "ci95_trials": wilson(values <= eta)}
        point |= {"bound": bound(eta, values), "cantelli": cantelli(eta, values)}
        point["ci95"] = of_rate(on) if sum(one.size > 0 for one in on) > 1 else np.nan
        curve |= {f"{name}.points.{number}.{key}": value for key, value in point.items()}
print(*(f"vulnerability_curve.{name}: {value}" for name, value in curve.items()), sep="\n")
