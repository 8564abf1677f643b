"""Surrogate safety measures: how near to an accident car and adversary came, per moment and per episode."""
