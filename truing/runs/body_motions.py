"""Where each body stands in each pose, as rotation matrices, for what is drawn of several bodies together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

_TURN = ["rx_rad", "ry_rad", "rz_rad"]
_PLACE = ["px_mm", "py_mm", "pz_mm"]
ENTRIES = [f"r{i}{j}" for i in range(3) for j in range(3)]


def body_motions(frames: Mapping[str, pd.DataFrame]) -> pd.DataFrame | None:
    """Columns pose, body, parent, px_mm .. pz_mm, and r00 .. r22 of x_parent = R x + p; None without poses."""
    poses = frames.get("poses")
    if poses is None or not len(poses):
        return None
    from truing.estimation.rotation import exp_so3

    chosen = poses[poses["default"] & (poses["status"] == "ok")]
    turns = exp_so3(chosen[_TURN].to_numpy(dtype=float)).reshape(-1, 9)
    found = chosen[["pose", "body", "parent", *_PLACE]].reset_index(drop=True)
    return found.assign(**dict(zip(ENTRIES, np.asarray(turns).T, strict=True)))
