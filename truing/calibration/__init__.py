"""Calibration of a machine: its numbers from measured poses and readings, which model suits, what data can know."""
