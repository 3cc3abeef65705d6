"""Tests and pages on real measurements, read from the folder `TRUING_REAL_DATA`."""
