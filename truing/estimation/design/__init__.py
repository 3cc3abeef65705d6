"""Design of measurements: identifiability before measuring, and choice of measurements."""
