"""What the adversary wants: rewards, default policy, legal actions, budget of the planner."""
