"""Evaluation of interferometer logs: fringes, readings, runs, displacements of a loaded platform, positioning of an
axis."""
