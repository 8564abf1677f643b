"""What is recorded of episodes, and the bags that it becomes."""
