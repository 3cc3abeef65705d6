"""Poses from dense scans of surfaces, without targets or labels."""
