"""Repeatability pose by pose, as ISO 9283 has it, of bodies and of single reflectors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.repeatability import (
    FEWEST,
    Figure,
    orientation_repeatability,
    position_repeatability,
    position_sigma,
)
from truing.estimation.rotation import exp_so3
from truing.stages.common.point_arrays import number_column, pose_points, positions, text_column
from truing.stages.common.repeats import Index
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Ids = tuple[int | str, ...]

_UM, _ARCSEC = 1e6, 180 / np.pi * 3600
_FRAME = 3  # targets that make a pose
_SEED = 9283
_ANGLES = ("RP_a", "RP_b", "RP_c")


def repeatability_rows(
    bodies: Mapping[str, Array], tables: Mapping[str, pa.Table], poses: Ids, groups: Sequence[Index], how: str
) -> Rows:
    """Return rows of ``pose_repeatability``: figures of every body and reflector at every pose that was repeated.

    ``bodies``: poses (B, 6) of each body seen from its reference, m and rad, angles small within a group, NaN where
    unknown. Reflectors come from the observations in ``tables``. RP needs five repeats, sigma two.
    """
    rows, rng = Rows("pose_repeatability"), np.random.default_rng(_SEED)
    seen: list[tuple[str, Array, Array | None]] = [(body, own[:, :3], own[:, 3:]) for body, own in bodies.items()]
    seen += list(_reflectors(tables, poses))
    for name, place, angle in seen:
        for group in groups:
            own = group[np.isfinite(place[group]).all(axis=1)]
            if len(own) > 1:
                _of_group(rows, name, poses[int(own[0])], place[own], None if angle is None else angle[own], how, rng)
    return rows


def _of_group(
    rows: Rows, name: str, pose: int | str, place: Array, angle: Array | None, how: str, rng: np.random.Generator
) -> None:
    place_um = _UM * place
    figures: list[tuple[str, Figure, str]] = [("sigma", position_sigma(place_um), "um")]
    if len(place) >= FEWEST:
        figures.append(("RP", position_repeatability(place_um, rng), "um"))
        if angle is not None:
            found = orientation_repeatability(_ARCSEC * angle)
            figures += [(figure, one, "arcsec") for figure, one in zip(_ANGLES, found, strict=True)]
    for figure, one, unit in figures:
        rows.add(
            subject=name, pose=pose, figure=figure, value=one.value, low=one.low, high=one.high, unit=unit,
            attained=len(place), told_by=how,
        )  # fmt: skip


def _reflectors(tables: Mapping[str, pa.Table], poses: Ids) -> Iterator[tuple[str, Array, None]]:
    """Each target of a body that has too few for a pose: its name and place (B, 3) in m, NaN where unknown.

    Seen from the body that others are seen from; where no body has a pose, from the instrument.
    """
    points = tables.get("observations")
    if points is None or not points.num_rows:
        return
    reference = _reference(tables.get("poses"), poses)
    for body in dict.fromkeys(text_column(points, "body")):
        own = pose_points(points, body, poses)
        if len(own.targets) >= _FRAME or str(body).startswith("leg"):
            continue
        for k, target in enumerate(own.targets):
            place = np.where(own.seen[:, k, None], own.points[:, k], np.nan)
            if reference is not None:
                place = np.einsum("bji,bj->bi", reference[0], place - reference[1])
            yield f"{body} {target}", place, None


def _reference(table: pa.Table | None, poses: Ids) -> tuple[Array, Array] | None:
    """Rotation (B, 3, 3) and place (B, 3) in m of the body that others are seen from, NaN where unknown; None where
    there is no pose of a body.

    It is the parent of other bodies, else the only body with a pose.
    """
    if table is None or not table.num_rows:
        return None
    bodies, parents = text_column(table, "body"), text_column(table, "parent")
    columns = [number_column(table, f"p{a}_mm") * 1e-3 for a in "xyz"]
    values = np.column_stack([*columns, *(number_column(table, f"r{a}_rad") for a in "xyz")])
    default = np.asarray(table.column("default").to_pylist(), bool) & np.isfinite(values).all(axis=1)
    parent = [one for one in dict.fromkeys(parents[default]) if one != "measurement"]
    name = next(iter(parent or dict.fromkeys(bodies[default])), None)
    place = positions(table.column("pose"), poses)
    rows = default & (bodies == name) & (parents == "measurement") & (place >= 0)
    if not rows.any():
        return None
    found = np.full((len(poses), 6), np.nan)
    found[place[rows]] = values[rows]
    turn = exp_so3(np.nan_to_num(found[:, 3:]))
    turn[~np.isfinite(found).all(axis=1)] = np.nan
    return turn, found[:, :3]
