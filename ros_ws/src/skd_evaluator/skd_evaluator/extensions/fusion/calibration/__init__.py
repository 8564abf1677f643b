"""Calibration of the simulator from physical trials: a world in which simulated cars go as recorded ones do."""
