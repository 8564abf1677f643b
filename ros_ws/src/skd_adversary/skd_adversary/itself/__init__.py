"""An adversary whose knowledge is the car itself: it plans by rollouts of copies of the controller with fresh noise."""
