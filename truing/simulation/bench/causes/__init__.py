"""Causes that act on readings and signals of a loaded sensor on its bench."""
