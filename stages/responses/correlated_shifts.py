"""Shifts whose points have errors in common: what every point of a pose does to each of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.deformation.correlated_shifts import CorrelatedShifts
from truing.estimation.measured_numbers import shift_number
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def handed_on(
    shifts: CorrelatedShifts, poses: tuple[int | str, ...], seen: Mask, identifier: str
) -> dict[str, pa.Table]:
    """The artifacts with what the shifts seen (B, L) have in common with poses, with each other, and with all poses."""
    covariances, sensitivities = Rows("shift_covariances"), Rows("shift_sensitivities")
    told = seen & shifts.there[:, None]
    b, leg, number = np.nonzero(told[:, :, None] & np.isfinite(shifts.with_poses))
    _add(covariances, poses, b, leg, [shifts.numbers[i] for i in number], shifts.with_poses[b, leg, number])
    b, leg, other = np.nonzero(told[:, :, None] & told[:, None] & np.tri(told.shape[1], dtype=bool))
    _add(covariances, poses, b, leg, _names(other), shifts.whole[b, leg, other])
    b, leg, parameter = np.nonzero(np.broadcast_to(told[..., None], shifts.effects.shape))
    sensitivities.add(
        pose=[poses[i] for i in b],
        leg=leg + 1,
        parameter=[shifts.parameters[i] for i in parameter],
        effect_um=shifts.effects[b, leg, parameter] * 1e6,
    )
    names = [*shifts.numbers, *_names(np.arange(told.shape[1]))]
    one, other = np.nonzero(np.tri(len(names), dtype=bool))
    frames = Rows("survey_covariances")
    frames.add(
        measured_number=[names[i] for i in one],
        other_number=[names[i] for i in other],
        joint_covariance=shifts.of_frames[one, other],
    )
    return {rows.artifact: rows.table(identifier) for rows in (covariances, sensitivities, frames)}


def _add(rows: Rows, poses: tuple[int | str, ...], b: Index, leg: Index, other: Sequence[object], value: Array) -> None:
    rows.add(pose=[poses[i] for i in b], measured_number=_names(leg), other_number=list(other), joint_covariance=value)


def _names(leg: Index) -> list[str]:
    return [shift_number(int(i) + 1) for i in leg]
