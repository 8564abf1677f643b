"""What a scenario is made of: the road, the road user who attacks, when it is over; the scenario joins them."""
