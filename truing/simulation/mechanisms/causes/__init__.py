"""Causes that act on mechanisms, and on records of bodies in space."""
