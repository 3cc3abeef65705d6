"""Sections of calibrations and requirements: figures, listings, sentences."""
