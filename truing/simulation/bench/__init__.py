"""Simulation of a loaded sensor on its bench: loads, readings, causes and the extended model."""
