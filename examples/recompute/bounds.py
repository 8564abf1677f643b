"""What mean and variance of distances alone say of P(d ≤ η): Theorem 1, and Cantelli's inequality."""
import numpy as np
def bound(eta, values):  # Theorem 1
    m, v = values.mean(), values.var(ddof=1) if values.size > 1 else np.nan
    return min(1.0, (v + 2 * eta * m) / (v + m * m)) if eta < m else 1.0
def cantelli(eta, values):  # the sharper bound, of the same mean and variance
    m, v = values.mean(), values.var(ddof=1) if values.size > 1 else np.nan
    return v / (v + (m - eta) ** 2) if eta < m and v >= 0 else 1.0
