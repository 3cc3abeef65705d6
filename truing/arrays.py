"""Types of numbers (`Array`), masks (`Mask`) and indices (`Index`), and of a table's row by column (`TableRow`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
TableRow = dict[str, Any]
