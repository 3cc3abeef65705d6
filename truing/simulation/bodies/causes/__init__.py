"""Causes of free bodies alone."""
