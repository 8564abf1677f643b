"""The world: states, trajectories, contact, cars, sensors, and the tick; episodes, their log and random draws."""
