"""Sections of a loaded sensor: displacements, compliance, calibration."""
