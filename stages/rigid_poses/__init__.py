"""The poses of bodies and scans as tables."""
