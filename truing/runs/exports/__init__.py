"""Exports of a run: each is a function from a run to files by name."""
