"""Write campaigns of a force sensor on six elastic legs, measured by interferometers, with hidden effects.

Written from the physics a second time, as the generator next to it, and sharing no code with ``truing``. SI throughout
(signals alone are mV, as in the files) and degrees Celsius; wrenches and displacements are six numbers, the linear ones
first.
"""
