"""The margin of the basic car, whose answers are known."""
