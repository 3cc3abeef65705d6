"""Design of measurements: identifiability before measuring, and choice of what to measure."""
