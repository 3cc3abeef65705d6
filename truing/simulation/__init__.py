"""Simulation of mechanisms, benches, axes, bodies and photographs, and the causes that act on them. Knows no data."""
