"""Pose accuracy and repeatability of an arm by ISO 9283: repeated poses of its measured targets and links."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.estimation.quality import repeated_groups
from truing.estimation.repeatability import (
    FEWEST,
    Figure,
    largest_distance,
    orientation_repeatability,
    position_repeatability,
    turned_from_first,
)
from truing.inference.observations import Epochs
from truing.simulation.mechanisms.chains.conditions import APPROACH
from truing.simulation.mechanisms.chains.distances import DistanceModel
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.stages.common.point_arrays import pose_ids
from truing.stages.common.repeats import DECLARED, declared_repeats
from truing.stages.diagnosis.diagnosis_data import DiagnosisData
from truing.stages.diagnosis.residual_tables import identified_table

_UM, _ARCSEC = 1e-6, np.pi / 180.0 / 3600.0
_SEED = 9283
_AXES = "abc"
# Readings of one command: they differ by less than this many standard deviations, or by rounding.
_SAME, _ROUNDING = 5.0, 1e-6


@dataclass(frozen=True)
class _Attained:
    """Attained and commanded values (B, K, 3) of the channels in the frame of the model, and which were seen; SI.

    ``attained`` of an orientation is a matrix in ``turned`` (B, K, 3, 3); its deviation is a rotation vector.
    """

    poses: tuple[int | str, ...]
    series: Index
    readings: Array
    approach: Array
    attained: Array
    deviation: Array
    turned: Array
    seen: Mask


def accuracy_table(data: DiagnosisData[Any], tables: Mapping[str, pa.Table]) -> pa.Table | None:
    """Rows of arm_accuracy.parquet; None without repeated poses of points or links.

    A command is the nominal chain at the readings, with places of base and tool fitted to all poses.
    """
    model = data.model
    if not isinstance(model, ChainModel) or isinstance(model, DistanceModel):
        return None
    parts = [_attained(model, attained) for attained in (data.calibration, data.held_out) if attained is not None]
    attained = _joined(parts)
    groups = _groups(attained, model, tables)
    rng, rows = np.random.default_rng(_SEED), []
    channels = model.channels
    for k, turned in enumerate(channels.is_rotation):
        if turned and data.calibration.frames.free:
            continue  # each pose has a frame of its own, by the targets of another link
        name = channels.links[k] if channels.names[k] in ("position", "orientation") else ""
        subject = name or f"{channels.links[k]} {channels.names[k]}"
        for group in groups:
            seen = group[attained.seen[group, k]]
            if len(seen) > 1:
                figures = _of_orientation(attained, k, seen) if turned else _of_position(attained, k, seen, rng)
                unit, si = ("arcsec", _ARCSEC) if turned else ("um", _UM)
                first = {"subject": subject, "pose": attained.poses[int(group[0])], "attained": len(seen), "unit": unit}
                rows += [
                    {
                        **first,
                        "figure": figure,
                        "value": value.value / si,
                        "low": None if np.isnan(value.low) else value.low / si,
                        "high": None if np.isnan(value.high) else value.high / si,
                    }
                    for figure, value in figures
                ]
    return identified_table("arm_accuracy", rows, "pose") if rows else None


def _attained(model: ChainModel, epochs: Epochs[Any]) -> _Attained:
    """Attained and commanded values of some poses."""
    plain = model.at(replace(epochs.conditions, coupling=None))
    frames, measured = epochs.frames, epochs.measured
    values = np.einsum("bji,bkj->bki", frames.R, measured.values - frames.t[:, None])
    commanded = plain.points(np.zeros(plain.shared_size), np.zeros((len(values), plain.local_size)))
    turned = model.channels.is_rotation
    deviation = np.where(turned[:, None], -commanded, values - commanded)
    conditions = epochs.conditions
    approach = conditions.covariates.get(APPROACH, np.ones_like(conditions.readings))
    return _Attained(
        conditions.poses,
        conditions.series,
        conditions.readings,
        approach,
        values,
        deviation,
        conditions.reference,
        measured.seen,
    )


def _joined(parts: list[_Attained]) -> _Attained:
    names = ("series", "readings", "approach", "attained", "deviation", "turned", "seen")
    poses = tuple(pose for part in parts for pose in part.poses)
    return _Attained(poses, **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _groups(attained: _Attained, model: ChainModel, tables: Mapping[str, pa.Table]) -> list[Index]:
    """Repeated poses of one series: those that repeat_of names, else those of equal readings of all joints."""
    table = tables.get("configurations")
    if table is not None and DECLARED in table.column_names:
        place, names = {pose: at for at, pose in enumerate(attained.poses)}, pose_ids(table)
        found = [[place[names[row]] for row in group if names[row] in place] for group in declared_repeats(table)]
        groups = [np.array(group, np.int64) for group in found]
    else:
        groups = repeated_groups(attained.readings, np.maximum(_SAME * model.known.reading_sigma, _ROUNDING))
    parts = [
        group[attained.series[group] == number] for group in groups for number in np.unique(attained.series[group])
    ]
    return [part for part in parts if len(part) > 1]


def _of_position(attained: _Attained, k: int, rows: Index, rng: np.random.Generator) -> Iterator[tuple[str, Figure]]:
    off, places = attained.deviation[rows, k], attained.attained[rows, k]
    yield "AP", _alone(float(np.linalg.norm(off.mean(0))))
    if len(rows) >= FEWEST:
        yield "RP", position_repeatability(places, rng)
    means = _by_approach(attained, rows, off)
    if len(means) > 1:
        yield "vAP", _alone(largest_distance(means))


def _of_orientation(attained: _Attained, k: int, rows: Index) -> Iterator[tuple[str, Figure]]:
    off = attained.deviation[rows, k]
    yield from ((f"AP_{axis}", _alone(float(value))) for axis, value in zip(_AXES, off.mean(0), strict=True))
    if len(rows) >= FEWEST:
        spread = orientation_repeatability(turned_from_first(attained.turned[rows, k], rows, [rows]))
        yield from ((f"RP_{axis}", deviation) for axis, deviation in zip(_AXES, spread, strict=True))
    means = _by_approach(attained, rows, off)
    if len(means) > 1:
        yield from ((f"vAP_{axis}", _alone(float(span))) for axis, span in zip(_AXES, np.ptp(means, 0), strict=True))


def _by_approach(attained: _Attained, rows: Index, off: Array) -> Array:
    """Mean deviations (D, 3) of the poses that came the same way, by the last movement of each joint; at least two of
    each."""
    approaches, number = np.unique(np.sign(attained.approach[rows]), axis=0, return_inverse=True)
    alike = [off[number.ravel() == approach_number] for approach_number in range(len(approaches))]
    return np.array([part.mean(0) for part in alike if len(part) > 1]).reshape(-1, 3)


def _alone(value: float) -> Figure:
    return Figure(value, np.nan, np.nan)
