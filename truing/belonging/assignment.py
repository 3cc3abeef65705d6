"""Assignment of columns to rows at the least total cost."""

from __future__ import annotations

import numpy as np

from truing.arrays import Array, Index


def cheapest_columns(cost: Array) -> Index:
    """Return the column (N,) of each row of a cost matrix (N, N), each used once, with the least sum; finite costs.

    Where the cheapest columns of all rows differ, they are the answer. Good tables are of this kind, and spare the
    time to load scipy.optimize.
    """
    cheapest = cost.argmin(axis=1) if cost.size else np.empty(0, np.int64)
    if len(np.unique(cheapest)) == len(cost):
        return cheapest
    from scipy.optimize import linear_sum_assignment

    columns: Index = linear_sum_assignment(cost)[1]
    return columns
