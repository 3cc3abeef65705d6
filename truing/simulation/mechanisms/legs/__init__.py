"""Legs of a parallel mechanism: geometry, closures, kinematics."""
