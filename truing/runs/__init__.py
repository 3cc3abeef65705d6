"""Runs as they lie on the disk, opened for notebooks, exports and comparisons."""
