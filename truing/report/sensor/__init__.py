"""The sections of a loaded sensor: its displacements, its compliance, its calibration."""
