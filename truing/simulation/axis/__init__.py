"""Simulation of one rotary or linear axis: encoder and reference readings at commanded positions."""
