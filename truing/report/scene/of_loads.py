"""The view of a loaded platform, load by load: its attachments displaced as it moves, and the legs that carry it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.report.load_steps import LOAD_UNITS, LOADS
from truing.report.numbers import with_uncertainty
from truing.report.scene.view import MOST_POINTS, Scene
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

_MOVED = ["dx_mm", "dy_mm", "dz_mm"]
_TURNED = ["rx_rad", "ry_rad", "rz_rad"]
_ARROW = 0.45  # of the view's size, for the largest load of its kind


def load_scene(tables: Tables) -> Scene | None:
    """The scene of every load case of which all six components are known; None without one, or without joints.

    ``tables`` with ``legs`` (leg, ax_mm .. az_mm, bx_mm .. bz_mm): the joints in the unloaded platform's frame.
    """
    cases, joints = filled(tables, "displacement"), filled(tables, "legs")
    if cases is None or joints is None:
        return None
    known = cases.dropna(subset=[*_MOVED, *_TURNED])
    known = known[known[list(LOADS.values())].ne(0.0).any(axis=1)]
    if not len(known):
        return None
    known = _largest_first(known).iloc[: MOST_POINTS // len(joints)]
    lower, upper = (joints[[f"{joint}{axis}_mm" for axis in "xyz"]].to_numpy(dtype=float) for joint in "ab")
    place = np.broadcast_to(upper, (len(known), *upper.shape)).copy()
    turn, moved = known[_TURNED].to_numpy(dtype=float), known[_MOVED].to_numpy(dtype=float)
    shift = moved[:, None] + np.cross(turn[:, None], place)
    numbers = tuple(int(leg) for leg in joints["leg"])
    covariance = _covariance(known)
    along = (upper - lower) / np.linalg.norm(upper - lower, axis=1, keepdims=True)
    return Scene(
        step="load",
        labels=tuple(_called(row) for row in known.to_dict("records")),
        names=tuple(f"b{leg}" for leg in numbers),
        place=place,
        shift=shift,
        leg=np.array(numbers),
        attached=np.ones(len(numbers), dtype=bool),
        own=np.zeros(len(numbers), dtype=bool),
        words=_words(place, shift, covariance, numbers),
        legs=numbers,
        lower=np.broadcast_to(lower, place.shape),
        upper=place,
        arrow=_arrows(known, float(np.ptp(upper, axis=0).max())),
        said=_said(place, shift, np.broadcast_to(along, place.shape), covariance, numbers),
        all_legs=True,
        ringed="upper joint",
    )


def _largest_first(cases: pd.DataFrame) -> pd.DataFrame:
    """Cases from the largest share of each axis' largest load on, so that the slider begins with what is seen best."""
    loads = cases[list(LOADS.values())].abs()
    share = (loads / loads.max().replace(0.0, 1.0)).max(axis=1)
    return cases.assign(share=share).sort_values("share", ascending=False, kind="stable")


def _called(row: dict) -> str:
    """``fz −9000 N, loading``."""
    loads = [f"{axis} {row[column]:+,.6g} {LOAD_UNITS[axis]}" for axis, column in LOADS.items() if row[column]]
    branch = row.get("branch")
    return ", ".join([*loads, *([str(branch)] if isinstance(branch, str) else [])])


def _covariance(cases: pd.DataFrame) -> NDArray[np.float64]:
    """Covariance (S, 6, 6) of the displacement, m and rad."""
    found = np.zeros((len(cases), 6, 6))
    for i in range(6):
        for j in range(i, 6):
            found[:, i, j] = found[:, j, i] = cases[f"cov_{i}_{j}"].to_numpy(dtype=float)
    return found


def _sigma_along(
    place: NDArray[np.float64], way: NDArray[np.float64], covariance: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Standard uncertainty (S, N) in um of how far points move along unit vectors ``way`` (S, N, 3)."""
    pull = np.concatenate([way, np.cross(1e-3 * place, way)], axis=-1)
    return 1e6 * np.sqrt(np.maximum(np.einsum("sni,sij,snj->sn", pull, covariance, pull), 0.0))


def _words(
    place: NDArray[np.float64], shift: NDArray[np.float64], covariance: NDArray[np.float64], legs: tuple[int, ...]
) -> tuple[tuple[str, ...], ...]:
    """How far each attachment moves, with the uncertainty of the platform's displacement."""
    size = np.linalg.norm(shift, axis=-1)
    noise = _sigma_along(place, shift / np.where(size > 0.0, size, 1.0)[..., None], covariance)
    return tuple(
        tuple(
            f"b{leg}: {with_uncertainty(1e3 * float(s), float(u), 'µm')}" for leg, s, u in zip(legs, *own, strict=True)
        )
        for own in zip(size, noise, strict=True)
    )


def _said(
    place: NDArray[np.float64],
    shift: NDArray[np.float64],
    along: NDArray[np.float64],
    covariance: NDArray[np.float64],
    legs: tuple[int, ...],
) -> tuple[tuple[str, ...], ...]:
    """How far each leg's joints move apart under each load."""
    longer = 1e3 * np.sum(shift * along, axis=-1)
    noise = _sigma_along(place, along, covariance)
    return tuple(
        tuple(
            f"Leg {leg}: its joints move apart by {with_uncertainty(float(s), float(u), 'µm')}."
            for leg, s, u in zip(legs, *own, strict=True)
        )
        for own in zip(longer, noise, strict=True)
    )


def _arrows(cases: pd.DataFrame, size: float) -> NDArray[np.float64]:
    """The load (S, 2, 3) from the platform's origin: a force along its axis, a torque along the one it turns about."""
    loads = cases[list(LOADS.values())].to_numpy(dtype=float)
    largest = np.abs(loads).max(axis=0)
    share = loads / np.where(largest > 0.0, largest, 1.0)
    tip = _ARROW * size * (share[:, :3] + share[:, 3:])
    return np.stack([np.zeros_like(tip), tip], axis=1)
