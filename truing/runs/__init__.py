"""Recorded runs, opened from their folders for notebooks, exports and comparisons."""
