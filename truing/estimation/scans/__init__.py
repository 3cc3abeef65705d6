"""Poses of dense scans, without targets or labels."""
