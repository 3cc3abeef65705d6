"""Generator of photographs of targets and of image rays for tests, independent of the measurement code.

Second implementation of what `truing` has of cameras and targets; it shares no code with it:

- directions are complex numbers w = (X + iY) / Z and a lens is a function of w (`lens.py`);
- rotations are quaternions (`tests.blind.generator.quaternions`);
- ring codes are drawn from their words (`ring_words.py`), bits of markers are read from OpenCV as data (`markers.py`);
- refraction bends rays by Snell's law or along a parabola (`hidden.py`).

`rays.py` makes image points without pictures, `scene.py` and `drawing.py` pictures, `telescope.py` the sample.
Lengths are millimetres, image coordinates pixels with the first pixel's centre at (0, 0), a camera's axes x to the
right, y down, z forward.
"""
