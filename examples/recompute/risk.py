"""The risk of assessment.json: run it as recompute.py, in the folder of a result that has one."""
import numpy as np
from intervals import layout, of_rate
from recompute import a
from scipy.stats import norm, t
FRONT, FLANK, STANDING, ABORTED = 1, 2, 3, 4
phis, scales, risk = (a["mode"] == 0).sum(), len(a["risk_scale"]), {}
touch = a["risk_touch"].reshape(scales, -1)
share, levels = a["risk_share"].reshape(scales, -1, phis), a["risk_levels"].reshape(scales, -1)
for k, scale in enumerate(a["risk_scale"]):
    runs = [mine[mine != ABORTED] == FRONT for mine in (touch[k, one::phis] for one in range(phis))]
    every = np.concatenate(runs)
    n, hits, size = len(every), every.sum(), a["risk_per_level"][k]
    said = {"scale": scale, "runs": n, "hits": hits, "flank": (touch[k] == FLANK).sum(), "gain": np.nan,
            "standing": (touch[k] == STANDING).sum(), "aborted": (touch[k] == ABORTED).sum()}
    if size:  # subset simulation: replicates, each a product of shares of its levels
        one = share[k].sum(axis=1)
        p, error = one.mean(), one.std(ddof=1) / np.sqrt(len(one))
        far = np.exp(t.ppf(0.975, len(one) - 1) * error / p) if p > 0 else np.nan
        ends = [p / far, min(1, p * far)] if p > 0 else [0, 0.1 ** (levels[k].min() - 1)]
        added = np.append(levels[k], levels[k].max()) - 1  # the last are those that found the levels
        episodes = touch.shape[1] + (size + added * (size - size // 10)).sum()
        form = layout(list((phis * share[k]).T))[3]
        reach = t.ppf(0.975, form["degrees_of_freedom"]) * form["standard_error"]
        by_phi = np.clip([p - reach, p + reach], 0, 1)
        said |= {"gain": p * (1 - p) / error**2 / (episodes - touch.shape[1]) if p * error > 0 else np.nan}
    else:  # crude: Wilson's, or the rule of three
        p, z, episodes, by_phi = hits / n, norm.ppf(0.975), touch.shape[1], of_rate([one * 1.0 for one in runs])
        half = z * np.sqrt(p * (1 - p) / n + (z / n) ** 2 / 4)
        ends = [(p + z * z / n / 2 + side * half) / (1 + z * z / n) for side in (-1, 1)] if hits else [0, min(1, 3 / n)]
    said |= {"value": p, "ci95": ends, "ci95_by_phi": by_phi, "episodes": episodes}
    risk |= {f"risk.scales.{k}.{name}": value for name, value in said.items()}
    risk |= {f"risk_{scale:g}": p, f"risk_{scale:g}_ci95": by_phi, f"risk_{scale:g}_ci95_runs": ends}
hits = (touch == FRONT).sum(axis=1)
if hits.any():  # failures are shown of the least scale that has ten, else of that with most
    k = next((k for k, many in enumerate(hits) if many >= 10), hits.argmax())
    runs, looked_at = (touch[k] != ABORTED).sum(), min(hits[k], 2000)
    said = {"scale": a["risk_scale"][k], "hits": hits[k], "runs": runs, "looked_at": looked_at}
    risk |= {f"risk.failures.{name}": value for name, value in said.items()}
print(*(f"{name}: {value}" for name, value in risk.items()), sep="\n")
