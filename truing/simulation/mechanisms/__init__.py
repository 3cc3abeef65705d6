"""Mechanisms: legs and their closures, structures, causes, and the model of points."""
