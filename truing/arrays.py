"""Types of arrays: of real numbers, of yes and no, and of whole numbers (places, counts, groups)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
