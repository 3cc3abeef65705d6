"""Poses of bodies and scans as tables."""
