"""Legs of a parallel mechanism: geometry, closure equations, kinematics."""
