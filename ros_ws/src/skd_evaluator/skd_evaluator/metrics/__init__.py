"""What is measured: distances between trajectories, their means and intervals, and figures that follow from them."""
