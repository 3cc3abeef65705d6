"""Prediction by an extended model of an axis."""
