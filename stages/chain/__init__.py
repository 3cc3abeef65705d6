"""Predictions by the extended model of an open chain."""
