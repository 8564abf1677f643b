"""Commands that make a model of a car, of people or of a proving ground from what was recorded."""
