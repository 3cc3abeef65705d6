"""Calibration of a machine: its parameters from measured poses and readings, choice of a model, observability."""
