"""Safe trajectories φ from files, plain csv and the recordings of the CITR dataset, and those of a regulator's test."""

from skd_sim.scenario.scenario_file import REGULATORY

from skd_adversary.safe_trajectories.citr import is_citr, read_citr
from skd_adversary.safe_trajectories.csv_file import read_csv_trajectory
from skd_adversary.safe_trajectories.sources import count_safe_trajectories, load_safe_trajectories

__all__ = [
    "REGULATORY",
    "count_safe_trajectories",
    "is_citr",
    "load_safe_trajectories",
    "read_citr",
    "read_csv_trajectory",
]
