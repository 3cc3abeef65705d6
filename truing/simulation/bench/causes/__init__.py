"""Causes of a bench: what makes readings and signals of a loaded sensor depart from the plain simulation."""
