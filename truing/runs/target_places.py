"""Where the targets of each body sit in its frame: as surveyed, else as measured on average over the poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

_XYZ = ["x_mm", "y_mm", "z_mm"]
_PLACE = ["px_mm", "py_mm", "pz_mm"]
_TURN = ["rx_rad", "ry_rad", "rz_rad"]
_SHIFT = ["dx_mm", "dy_mm", "dz_mm"]
COLUMNS = ["body", "target", *_XYZ, "leg"]


def target_places(frames: Mapping[str, pd.DataFrame]) -> pd.DataFrame | None:
    """Columns body, target, x_mm, y_mm, z_mm, leg; None where neither survey nor poses say."""
    survey = frames.get("survey")
    if survey is not None and len(survey):
        return survey[COLUMNS]
    if not all(len(frames.get(name, ())) for name in ("observations", "poses", "residuals")):
        return None
    return _averages(frames["observations"], frames["poses"], frames["residuals"])


def _averages(observations: pd.DataFrame, poses: pd.DataFrame, residuals: pd.DataFrame) -> pd.DataFrame:
    """Measured points seen from their body, less their residual: what the fit takes the body to be."""
    chosen = poses[poses["default"] & (poses["status"] == "ok")]
    bases = chosen[["pose", "body", *_PLACE, *_TURN]].rename(columns={"body": "parent"})
    kept = residuals[~residuals["rejected"]].dropna(subset=_SHIFT)
    points = observations.merge(kept, on=["pose", "body", "target"]).merge(chosen, on=["pose", "body"])
    points = points.merge(bases, on=["pose", "parent"], how="left", suffixes=("", "_of_parent"))
    place = points[_XYZ].to_numpy(dtype=float)
    seen_directly = (points["parent"] == "measurement").to_numpy()
    place = np.where(seen_directly[:, None], place, _seen_from(place, points, "_of_parent"))
    place = _seen_from(place, points, "") - points[_SHIFT].to_numpy(dtype=float)
    found = points[["body", "target"]].assign(**dict(zip(_XYZ, place.T, strict=True)))
    means = found.groupby(["body", "target"], sort=False)[_XYZ].mean().reset_index().dropna()
    return means.assign(leg=np.nan)[COLUMNS]


def _seen_from(place: np.ndarray, poses: pd.DataFrame, suffix: str) -> np.ndarray:
    """Points (N, 3) of the parent's frame in the frames of N bodies."""
    from truing.estimation.rotation import exp_so3

    turn = poses[[f"{c}{suffix}" for c in _TURN]].to_numpy(dtype=float)
    origin = poses[[f"{c}{suffix}" for c in _PLACE]].to_numpy(dtype=float)
    return np.einsum("nji,nj->ni", exp_so3(turn), place - origin)
