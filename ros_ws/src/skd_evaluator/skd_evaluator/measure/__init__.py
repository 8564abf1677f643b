"""What is measured: distances between trajectories, their means and intervals, and what is read off them."""
