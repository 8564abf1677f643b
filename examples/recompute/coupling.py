"""The least cost of a coupling of two curves: the discrete Fréchet distance, and time warping."""
import numpy as np
def couple(phi, psi, join, slant):  # of (max, 1) Fréchet, of (np.add, 2) warping
    gap, way = np.linalg.norm(phi[:, None] - psi, axis=2), np.full((len(phi) + 1, len(psi) + 1), np.inf)
    way[0, 0] = 0.0
    for i, j in np.ndindex(gap.shape):
        way[i + 1, j + 1] = min(join(min(way[i, j + 1], way[i + 1, j]), gap[i, j]), join(way[i, j], slant * gap[i, j]))
    return way[-1, -1] / sum(gap.shape) ** (slant - 1)
