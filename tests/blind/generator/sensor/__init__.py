"""Writes campaigns of a force sensor on six elastic legs, its platform watched by interferometers, with effects hidden.

Written from the physics a second time, as the generator beside it, and sharing no code with ``truing``. SI throughout
(signals alone are mV, as in the files) and degrees Celsius; wrenches and displacements are six numbers, the linear ones
first.
"""
