"""Conversion between tables of rays and an adjusted network."""
