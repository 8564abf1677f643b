"""Learning the predictive model of a car from logs: a law by maximum likelihood, or a forest where none fits."""

from skd_adversary.car_models.fit import fit_car
from skd_adversary.car_models.observations import Observations, RecordedEpisode, observe
from skd_adversary.car_models.prediction import SeenAndPredicted, learn_car

__all__ = ["Observations", "RecordedEpisode", "SeenAndPredicted", "fit_car", "learn_car", "observe"]
