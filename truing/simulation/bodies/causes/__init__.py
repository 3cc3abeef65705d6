"""Causes that act only on free bodies."""
