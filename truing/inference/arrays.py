"""Types of arrays: of real numbers of any precision, of yes and no, and of whole numbers (places, counts, groups)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Integers = NDArray[np.intp]
