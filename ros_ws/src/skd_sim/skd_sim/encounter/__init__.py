"""What an encounter is made of: the road, the road user who attacks, when it is over, and the scenario that joins them."""
