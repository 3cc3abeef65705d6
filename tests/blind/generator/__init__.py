"""Writes campaign folders of a photogrammetry campaign on a 6-pus or an ups, with effects hidden in them; ``sensor``
writes those of a force sensor.

Written from the physics a second time and sharing no code with ``truing``, so that a mistake on one side
cannot hide on the other. Lengths are millimetres throughout (as in the files), angles radians, temperatures
degrees Celsius. A campaign is drawn in four steps, one module each: the schedule (what was asked), the
machine (what nature made of it, changed by the effects), the instrument (what was recorded), the folder (what
was written down).
"""
