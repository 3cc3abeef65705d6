"""Causes that act on mechanisms, and on what instruments record of bodies in space."""
