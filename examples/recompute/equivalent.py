"""The equivalent multiplier of assessment.json: run it as recompute.py, with the path of the reference sweep's file."""
import json
import sys
import numpy as np
from recompute import a, each, needed, ran, sets
from scipy.optimize import isotonic_regression
file = np.load(sys.argv[1])
grid, swept, about = file["multipliers"], file["deformations"], json.loads(file["about"].tobytes())
rows = ([rows for name, _, rows in sets if name == "objectives.deformation."] or [sets[0][2]])[0] & ran
rng, paired = np.random.default_rng(np.random.SeedSequence(int(a["seed"]))), about["seed"] == a["seed"]
def read(sums, counts):  # where the rising means of the sweep reach the car's
    fit = isotonic_regression(sums[1:] / counts[1:], weights=counts[1:]).x
    first, after = (np.searchsorted(fit, sums[0] / counts[0], side) for side in ("left", "right"))
    if first == len(grid) or after == 0:
        return np.inf if after else -np.inf
    if after > first:
        return (grid[first] + grid[after - 1]) / 2
    share = (sums[0] / counts[0] - fit[first - 1]) / (fit[first] - fit[first - 1])
    return grid[first - 1] + share * (grid[first] - grid[first - 1])
def draw(length):  # how often each attempt is drawn, of n of them n − 1
    drawn = rng.integers(length, size=(2000, max(1, length - 1)))
    return np.array([np.bincount(one, minlength=length) for one in drawn], float)
def ends(reads):
    return np.quantile(reads, [0.025, 0.975], method="inverted_cdf")
tables, within = [], np.zeros((2, 2000, len(grid) + 1))
for index, (_, mine) in enumerate(each):
    number = a["episode_id"][rows & mine] & 0xFFFFFFFF
    table = np.full((max(swept.shape[2], number.max(initial=-1) + 1), len(grid) + 1), np.nan)
    table[number, 0], table[: swept.shape[2], 1:] = needed[rows & mine], swept[:, index].T
    tables.append(np.array([np.nan_to_num(table), ~np.isnan(table)], float))
    for columns in [slice(None)] if paired else [slice(0, 1), slice(1, None)]:
        within[:, :, columns] += draw(len(table)) @ tables[-1][:, :, columns]
sums, counts = np.array([one.sum(axis=1) for one in tables]).swapaxes(0, 1)
drawn = rng.integers(len(each), size=(2000, len(each)))
found = {"": read(sums.sum(axis=0), counts.sum(axis=0)), "_ci95_these_phi": ends([read(*one) for one in within.swapaxes(0, 1)]),
         "_ci95": ends([read(sums[one].sum(axis=0), counts[one].sum(axis=0)) for one in drawn])}
print(*(f"equivalent_multiplier{name}: {value}" for name, value in found.items()), sep="\n")
