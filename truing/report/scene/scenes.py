"""Scenes of the 3-D view: targets of a body pose by pose, or a platform load by load, with its legs."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truing.report.calibration.calibrations import displayed_calibration, rows_of
from truing.report.numbers import with_uncertainty
from truing.report.scene.view import MOST_DRAWN, DrawnScene
from truing.report.tables import LOAD_UNITS, LOADS, SHIFT, SIGMA, XYZ, Tables, table_or_none

_PLACE = ["px_mm", "py_mm", "pz_mm"]
_ENTRIES = [f"r{i}{j}" for i in range(3) for j in range(3)]
_PLATFORM = "platform"
_LEG = r"leg(\d+)"

_MOVED = ["dx_mm", "dy_mm", "dz_mm"]
_TURNED = ["rx_rad", "ry_rad", "rz_rad"]
_ARROW = 0.45  # length for the largest load of its kind, as a share of the view's size


def pose_scene(tables: Tables, residuals: pd.DataFrame, body: str) -> DrawnScene:
    """Return the scene of a body from its ``residuals`` (accepted ones, with dx_mm, dy_mm, dz_mm), with legs if it has
    any.

    ``tables`` with ``shape``: places of targets (body, target, x_mm, y_mm, z_mm, leg); ``motions``: poses of bodies.
    """
    shape = tables["shape"]
    seen = _targets(shape, residuals, body)
    legs = _of_legs(shape, tables["residuals"]) if body == _PLATFORM else seen.iloc[:0]
    poses = _slider_poses(residuals, len(seen) + len(legs))
    motion = _motions(tables, [body, *legs["body"].unique()], poses)
    points, shift = _points(seen, residuals, poses)
    leg_points, leg_shift = _points(legs, tables["residuals"], poses)
    _in_frame_of(leg_points, leg_shift, legs, body, motion)
    all_points, targets = np.concatenate([points, leg_points], axis=1), _with_legs(seen, legs)
    moved = np.concatenate([shift, leg_shift], axis=1)
    numbers, lower, upper = _joints(tables, body, motion, len(poses))
    attached = targets["at"].to_numpy(dtype=float)
    return DrawnScene(
        step="pose",
        labels=tuple(map(str, poses)),
        names=tuple(targets["target"].astype(str)),
        place=all_points,
        shift=moved,
        leg=np.nan_to_num(targets["leg"].to_numpy(dtype=float)).astype(int),
        attached=np.isfinite(attached),
        own=np.arange(len(targets)) >= len(seen),
        words=_words(tables, targets, moved, poses),
        legs=numbers,
        lower=lower,
        upper=upper,
        captions=_pose_captions(tables, poses, numbers),
        all_legs=True,
    )


def _targets(shape: pd.DataFrame, residuals: pd.DataFrame, body: str) -> pd.DataFrame:
    """Return targets of the body that were seen in any pose, with the leg of their attachment."""
    seen = set(residuals["target"])
    of_body = shape[(shape["body"] == body) & shape["target"].isin(seen)].reset_index(drop=True)
    return of_body.assign(at=of_body["leg"])


def _of_legs(shape: pd.DataFrame, residuals: pd.DataFrame) -> pd.DataFrame:
    """Return targets of the bodies ``leg1``, ``leg2``, which belong to their leg."""
    number = shape["body"].map(_leg_of)
    seen = set(zip(residuals["body"], residuals["target"], strict=True))
    known = [key in seen for key in zip(shape["body"], shape["target"], strict=True)]
    keep = number.notna() & np.array(known, dtype=bool)
    return shape[keep].assign(leg=number[keep], at=np.nan).reset_index(drop=True)


def _leg_of(body: str) -> float:
    match = re.fullmatch(_LEG, body)
    return float(match[1]) if match else float("nan")


def _with_legs(table: pd.DataFrame, legs: pd.DataFrame) -> pd.DataFrame:
    return pd.concat([table, legs], ignore_index=True) if len(legs) else table


def _slider_poses(residuals: pd.DataFrame, points: int) -> list[int | str]:
    """Return the poses of the slider: those with the largest deformation first, as many as a page holds."""
    size = (residuals[SHIFT] ** 2).sum(axis=1).groupby(residuals["pose"], sort=False).mean()
    order = size.sort_values(ascending=False, kind="stable").index
    return list(order[: max(1, MOST_DRAWN // max(points, 1))])


def _points(
    targets: pd.DataFrame, residuals: pd.DataFrame, poses: list[int | str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return places and displacements (S, N, 3) in the targets' own bodies, NaN where a pose has none."""
    positions = np.broadcast_to(targets[XYZ].to_numpy(dtype=float), (len(poses), len(targets), 3)).copy()
    used = residuals[~residuals["rejected"]].set_index(["pose", "body", "target"])[SHIFT]
    keys = [(pose, b, t) for pose in poses for b, t in zip(targets["body"], targets["target"], strict=True)]
    shifts = used.reindex(keys).to_numpy(dtype=float, copy=True).reshape(len(poses), len(targets), 3)
    return positions, shifts


_Motions = dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]


def _motions(tables: Tables, bodies: list[str], poses: list[int | str]) -> _Motions:
    """Return for each body its place (S, 3) and rotation (S, 3, 3) relative to the base, NaN where a pose has none."""
    known = table_or_none(tables, "motions")
    if known is None:
        return {}
    motions = {}
    for name in bodies:
        of_body = known[known["body"] == name].set_index("pose").reindex(poses)
        motions[name] = of_body[_PLACE].to_numpy(dtype=float), of_body[_ENTRIES].to_numpy(dtype=float).reshape(-1, 3, 3)
    return motions


def _in_frame_of(
    points: NDArray[np.float64], shifts: NDArray[np.float64], targets: pd.DataFrame, body: str, motion: _Motions
) -> None:
    """Bring points and shifts (S, N, 3) of other bodies' targets into the frame of this body."""
    for name in targets["body"].unique():
        of_body = (targets["body"] == name).to_numpy()
        if body not in motion or name not in motion:
            points[:, of_body] = np.nan
            continue
        (p, R), (origin, turn) = motion[name], motion[body]
        seen = np.einsum("sij,snj->sni", R, points[:, of_body]) + (p - origin)[:, None]
        points[:, of_body] = np.einsum("sji,snj->sni", turn, seen)
        shifts[:, of_body] = np.einsum("sji,sjk,snk->sni", turn, R, shifts[:, of_body])


def _joints(
    tables: Tables, body: str, motion: _Motions, steps: int
) -> tuple[tuple[int, ...], NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Return legs and their joints (S, L, 3) in the platform's frame by the calibration shown."""
    fitted = table_or_none(tables, "calibration")
    if fitted is None or body != _PLATFORM or body not in motion:
        return _attachments(tables, body), None, None
    known = rows_of(fitted, displayed_calibration(tables, fitted)).dropna(subset=["leg"])
    wide = known.pivot_table(index="leg", columns="parameter", values="identified")
    names = [[f"{joint}_{axis}" for axis in "xyz"] for joint in "ab"]
    if not {*names[0], *names[1]} <= set(wide.columns):
        return _attachments(tables, body), None, None
    lower, upper = (wide[columns].to_numpy(dtype=float) for columns in names)
    origin, turn = motion[body]
    seen = np.einsum("sji,slj->sli", turn, lower[None] - origin[:, None])
    return tuple(int(leg) for leg in wide.index), seen, np.broadcast_to(upper, (steps, *upper.shape))


def _attachments(tables: Tables, body: str) -> tuple[int, ...]:
    """Return the legs at whose attachments the body has targets."""
    shape = tables["shape"]
    legs = shape.loc[(shape["body"] == body), "leg"].dropna().unique()
    return tuple(sorted(int(leg) for leg in legs))


def _words(
    tables: Tables, targets: pd.DataFrame, shifts: NDArray[np.float64], poses: list[int | str]
) -> tuple[tuple[str, ...], ...]:
    """Return per pose and target its displacement in words, with the noise of point and survey in that direction."""
    sigma = _noise(tables, targets, poses)
    size = np.linalg.norm(shifts, axis=-1)
    along = np.sqrt(np.sum((shifts * sigma) ** 2, axis=-1)) / np.where(size > 0.0, size, np.nan)
    names = [str(name) for name in targets["target"]]
    return tuple(
        tuple(
            f"{name}: {with_uncertainty(1e3 * s, 1e3 * u if np.isfinite(u) else None, 'µm')}" if np.isfinite(s) else ""
            for name, s, u in zip(names, sizes, noise, strict=True)
        )
        for sizes, noise in zip(size, along, strict=True)
    )


def _noise(tables: Tables, targets: pd.DataFrame, poses: list[int | str]) -> NDArray[np.float64]:
    """Return standard deviations (S, N, 3) in mm of measured points and survey together, NaN where unknown."""
    keys = list(zip(targets["body"], targets["target"], strict=True))
    points, survey = table_or_none(tables, "observations"), table_or_none(tables, "survey")
    if points is None:
        return np.full((len(poses), len(targets), 3), np.nan)
    wanted = [(pose, *key) for pose in poses for key in keys]
    by_point = points.set_index(["pose", "body", "target"])[SIGMA]
    is_observed = (
        by_point[~by_point.index.duplicated()].reindex(wanted).to_numpy(dtype=float).reshape(len(poses), len(keys), 3)
    )
    if survey is None or not set(SIGMA) <= set(survey.columns):
        return is_observed
    placed = survey.set_index(["body", "target"])[SIGMA].reindex(keys).to_numpy(dtype=float)
    return np.sqrt(is_observed**2 + np.nan_to_num(placed) ** 2)


def _pose_captions(tables: Tables, poses: list[int | str], legs: tuple[int, ...]) -> tuple[tuple[str, ...], ...]:
    """Return per pose and leg the shift of its attachment and the displacement of its actuator."""
    shifts = table_or_none(tables, "deformation")
    if shifts is None or not legs:
        return ()
    indexed = shifts.set_index(["pose", "leg"])
    indexed = indexed[~indexed.index.duplicated()]
    return tuple(tuple(_of_leg(indexed, pose, leg) for leg in legs) for pose in poses)


def _of_leg(shifts: pd.DataFrame, pose: int | str, leg: int) -> str:
    if (pose, leg) not in shifts.index:
        return f"Leg {leg}: its attachment was not measured in this pose."
    row = shifts.loc[(pose, leg)]
    shift = with_uncertainty(float(row["delta_bz_um"]), float(row["sigma_um"]), "µm")
    rejected_text = " (left out as gross error)" if bool(row.get("rejected", False)) else ""
    drive = f"; displacement of its actuator {row['delta_rho_mm']:+.3f} mm" if np.isfinite(row["delta_rho_mm"]) else ""
    return f"Leg {leg}: shift of its attachment along z {shift}{rejected_text}{drive}."


def load_scene(tables: Tables) -> DrawnScene | None:
    """Return the scene of all load cases with six known components; None without any, or without joints.

    ``tables`` with ``legs`` (leg, ax_mm .. az_mm, bx_mm .. bz_mm): joints in the unloaded platform's frame.
    """
    cases, joints = table_or_none(tables, "displacement"), table_or_none(tables, "legs")
    if cases is None or joints is None:
        return None
    known = cases.dropna(subset=[*_MOVED, *_TURNED])
    known = known[known[list(LOADS.values())].ne(0.0).any(axis=1)]
    if not len(known):
        return None
    known = _largest_first(known).iloc[: MOST_DRAWN // len(joints)]
    lower, upper = (joints[[f"{joint}{axis}_mm" for axis in "xyz"]].to_numpy(dtype=float) for joint in "ab")
    points = np.broadcast_to(upper, (len(known), *upper.shape)).copy()
    turn, moved = known[_TURNED].to_numpy(dtype=float), known[_MOVED].to_numpy(dtype=float)
    shift = moved[:, None] + np.cross(turn[:, None], points)
    numbers = tuple(int(leg) for leg in joints["leg"])
    covariance = _covariance(known)
    along = (upper - lower) / np.linalg.norm(upper - lower, axis=1, keepdims=True)
    return DrawnScene(
        step="load",
        labels=tuple(_load_case_name(row) for row in known.to_dict("records")),
        names=tuple(f"b{leg}" for leg in numbers),
        place=points,
        shift=shift,
        leg=np.array(numbers),
        attached=np.ones(len(numbers), dtype=bool),
        own=np.zeros(len(numbers), dtype=bool),
        words=_words_of_loads(points, shift, covariance, numbers),
        legs=numbers,
        lower=np.broadcast_to(lower, points.shape),
        upper=points,
        arrow=_arrows(known, float(np.ptp(upper, axis=0).max())),
        captions=_load_captions(points, shift, np.broadcast_to(along, points.shape), covariance, numbers),
        all_legs=True,
        ringed="upper joint",
    )


def _largest_first(cases: pd.DataFrame) -> pd.DataFrame:
    """Return cases by their share of each axis' largest load, so that the slider begins with the clearest."""
    loads = cases[list(LOADS.values())].abs()
    share = (loads / loads.max().replace(0.0, 1.0)).max(axis=1)
    return cases.assign(share=share).sort_values("share", ascending=False, kind="stable")


def _load_case_name(row: dict) -> str:
    """Return the name of a load case: ``fz −9000 N, loading``."""
    loads = [f"{axis} {row[column]:+,.6g} {LOAD_UNITS[axis]}" for axis, column in LOADS.items() if row[column]]
    branch = row.get("branch")
    return ", ".join([*loads, *([str(branch)] if isinstance(branch, str) else [])])


def _covariance(cases: pd.DataFrame) -> NDArray[np.float64]:
    """Return the covariance (S, 6, 6) of the displacement, m and rad."""
    covariance = np.zeros((len(cases), 6, 6))
    for i in range(6):
        for j in range(i, 6):
            covariance[:, i, j] = covariance[:, j, i] = cases[f"cov_{i}_{j}"].to_numpy(dtype=float)
    return covariance


def _sigma_along(
    points: NDArray[np.float64], direction: NDArray[np.float64], covariance: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the standard uncertainty (S, N) in um of the motion of points along unit vectors ``direction`` (S, N,
    3)."""
    pull = np.concatenate([direction, np.cross(1e-3 * points, direction)], axis=-1)
    return 1e6 * np.sqrt(np.maximum(np.einsum("sni,sij,snj->sn", pull, covariance, pull), 0.0))


def _words_of_loads(
    points: NDArray[np.float64], shift: NDArray[np.float64], covariance: NDArray[np.float64], legs: tuple[int, ...]
) -> tuple[tuple[str, ...], ...]:
    """Return the motion of each attachment in words, with the uncertainty from the platform's displacement."""
    size = np.linalg.norm(shift, axis=-1)
    noise = _sigma_along(points, shift / np.where(size > 0.0, size, 1.0)[..., None], covariance)
    return tuple(
        tuple(
            f"b{leg}: {with_uncertainty(1e3 * float(s), float(u), 'µm')}" for leg, s, u in zip(legs, *pair, strict=True)
        )
        for pair in zip(size, noise, strict=True)
    )


def _load_captions(
    points: NDArray[np.float64],
    shift: NDArray[np.float64],
    along: NDArray[np.float64],
    covariance: NDArray[np.float64],
    legs: tuple[int, ...],
) -> tuple[tuple[str, ...], ...]:
    """Return the change in distance of each leg's joints under each load."""
    longer = 1e3 * np.sum(shift * along, axis=-1)
    noise = _sigma_along(points, along, covariance)
    return tuple(
        tuple(
            f"Leg {leg}: change of the distance between its joints {with_uncertainty(float(s), float(u), 'µm')}."
            for leg, s, u in zip(legs, *pair, strict=True)
        )
        for pair in zip(longer, noise, strict=True)
    )


def _arrows(cases: pd.DataFrame, size: float) -> NDArray[np.float64]:
    """Return the load (S, 2, 3) as arrows from the platform's origin: force along its axis, torque along its rotation
    axis."""
    loads = cases[list(LOADS.values())].to_numpy(dtype=float)
    largest = np.abs(loads).max(axis=0)
    share = loads / np.where(largest > 0.0, largest, 1.0)
    tip = _ARROW * size * (share[:, :3] + share[:, 3:])
    return np.stack([np.zeros_like(tip), tip], axis=1)
