"""Array types: real numbers of any precision, booleans, and integers (indices, counts, group numbers)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Integers = NDArray[np.intp]
