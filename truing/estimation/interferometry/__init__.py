"""What interferometer logs say: fringes, readings, runs, displacements of a loaded platform, positioning of an axis."""
