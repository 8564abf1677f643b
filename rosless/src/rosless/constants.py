"""Numbers that several modules share."""

S_TO_NS = 1000 * 1000 * 1000

# rmw's "infinite" duration, and the largest value of a signed 64-bit integer that DDS uses for the same
DURATION_INFINITE_NS = 9223372036854775807
