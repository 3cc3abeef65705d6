"""Readers of raw files, one per format; no other package opens raw files."""
