"""Simulation of photographs: rays of all poses as a function of cameras, scale bars and air."""
