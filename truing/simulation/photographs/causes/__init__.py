"""Causes that photographs show: of cameras, of scale bars, of what rays pass through."""
