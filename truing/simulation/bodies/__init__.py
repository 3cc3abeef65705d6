"""Simulation of free bodies, without a mechanism."""
