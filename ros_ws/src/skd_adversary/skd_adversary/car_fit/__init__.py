"""Learning the predictive model of a car from logs: a law by maximum likelihood, or a forest where none fits."""

from skd_adversary.car_fit.fit import fit_car
from skd_adversary.car_fit.observations import Observations, Recording, observe
from skd_adversary.car_fit.prediction import learn_car

__all__ = ["Observations", "Recording", "fit_car", "learn_car", "observe"]
