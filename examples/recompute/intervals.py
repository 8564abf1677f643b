"""Intervals by φ, as docs/metrics.md says: the mean of values that come in groups, a rate, and a distance."""
import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm, skew, t
def layout(groups):  # the one-way layout: sizes, means, squares within φ; what `clustering` has of it; the mean
    groups = [one for one in groups if one.size]
    n, m = np.array([len(one) for one in groups]), np.array([one.mean() for one in groups])
    inside, all_n, mean = sum(((one - one.mean()) ** 2).sum() for one in groups), n.sum(), (n * m).sum() / n.sum()
    w, within, k = n / all_n, inside / (all_n - len(n)) if all_n > len(n) else np.nan, len(n)
    typical = (all_n - (n * w).sum()) / (k - 1) if k > 1 else np.nan
    between = max(0.0, ((n * (m - mean) ** 2).sum() / (k - 1) - np.nan_to_num(within)) / typical) if k > 1 else np.nan
    cr2 = w**2 / (1 - w) if k > 1 else w * np.nan
    spread, centred = np.nan_to_num(between + within / n), np.eye(k) - w
    form = (centred.T * cr2) @ centred * (spread if spread.sum() > 0 else 1 / n)
    said = {"safe_trajectories": k, "values": all_n, "standard_error": np.sqrt((cr2 * (m - mean) ** 2).sum()),
            "degrees_of_freedom": np.trace(form) ** 2 / (form * form.T).sum(), "variance_between": between,
            "variance_within": within, "intraclass_correlation": between / (between + within or np.nan)}
    return n, m, inside, said, mean
def of_rate(groups):  # Wilson's with the effective number of runs, and Student's quantile
    said, p = layout(groups)[3:]
    error, q = said["standard_error"], t.ppf(0.975, said["degrees_of_freedom"])
    runs = p * (1 - p) / error**2 if error > 0 else said["values"]
    half = q * np.sqrt(p * (1 - p) / runs + (q / runs) ** 2 / 4)
    return [(p + q * q / runs / 2 + side * half) / (1 + q * q / runs) for side in (-1, 1)]
def of_distance(groups, ratio, scale, low=-np.inf, high=np.inf, side=1, tail=1.25, top=6):
    n, m, inside, _, mean = layout(groups)
    f, z, rho = n.sum() - 1, norm.ppf(0.975), np.logspace(-4, top, 40 * (top + 4) + 1)
    v = rho[:, None] + 1 / n
    centre = (m / v).sum(axis=1) / (1 / v).sum(axis=1)
    squares = inside + ((m - centre[:, None]) ** 2 / v).sum(axis=1)
    prior = 4 * np.log1p((np.log(rho / ratio) / scale) ** 2 / 3)
    x = np.log(v).sum(axis=1) + np.log((1 / v).sum(axis=1)) + f * np.log(squares) + prior
    share, error = np.exp((x.min() - x) / 2), np.sqrt(squares / f * (v @ (n / n.sum()) ** 2))
    if share[-1] > 1e-3 and top == 6:  # values of one φ hardly vary: ρ up to six decades beyond what φ show
        shown = np.log10(m.var(ddof=1) / (inside / f))
        return of_distance(groups, ratio, scale, low, high, side, tail, 6 + max(1, int(np.ceil(shown))))
    share /= share.sum()
    half = brentq(lambda h: share @ t.cdf(h / error, f) - 0.975, 0, 1e3 * error.max())
    out = half + max(0, tail + side * skew(m)) * (1 + 2 * z * z) / (6 * np.sqrt(len(n))) * half / z
    return np.clip([mean - (half if side > 0 else out), mean + (out if side > 0 else half)], low, high)
