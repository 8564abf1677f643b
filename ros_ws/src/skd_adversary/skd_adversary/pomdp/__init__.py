"""Planning under partial observation: the interface of a POMDP, what is believed, and the search over beliefs."""
