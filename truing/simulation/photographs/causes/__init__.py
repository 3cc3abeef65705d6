"""Causes that act on photographs: on cameras, scale bars, and the path of rays."""
