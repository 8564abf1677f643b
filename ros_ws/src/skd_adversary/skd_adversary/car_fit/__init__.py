"""Learning the predictive model of a car from logs, by maximum likelihood."""

from skd_adversary.car_fit.fit import fit_car
from skd_adversary.car_fit.observations import Observations, Recording, observe

__all__ = ["Observations", "Recording", "fit_car", "observe"]
