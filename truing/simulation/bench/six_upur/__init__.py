"""A six-axis force sensor on six elastic legs (6-UPUR): kinematics, elasticity, tolerances, loading."""
