"""Comparison of runs of one machine: which of its parameters changed from one campaign to the next."""
