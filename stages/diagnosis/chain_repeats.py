"""Pose accuracy and repeatability of an arm by ISO 9283: repeated poses of its measured targets and links."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask, TableRow
from truing.estimation.quality import repeated_groups
from truing.estimation.repeatability import (
    FEWEST,
    Figure,
    distance_figures,
    largest_change,
    largest_distance,
    orientation_distance_figures,
    orientation_repeatability,
    position_repeatability,
    turned_from_first,
)
from truing.inference.observations import Epochs
from truing.simulation.effects_model import EffectsModel
from truing.simulation.inputs import ORDER
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
# Repeats of one look at a pose for its drift, as in the standard's test.
_OF_LOOK = 10
_Figures = Iterator[tuple[str, Figure]]


@dataclass(frozen=True)
class _Attained:
    """Attained and commanded values (B, K, 3) of the channels in the frame of the model, and which were seen; SI.

    ``attained`` of an orientation is a matrix in ``turned`` (B, K, 3, 3); its deviation is a rotation vector.
    """

    poses: tuple[int | str, ...]
    series: Index
    order: Array
    readings: Array
    approach: Array
    attained: Array
    commanded: Array
    deviation: Array
    turned: Array
    is_observed: Mask
    is_rotation: Mask


def accuracy_table(data: DiagnosisData[EffectsModel], tables: Mapping[str, pa.Table]) -> pa.Table | None:
    """Rows of arm_accuracy.parquet; None without repeated poses of points or links.

    A command is the nominal chain at the readings, with places of base and tool fitted to all poses.
    """
    model = data.model
    if not isinstance(model, ChainModel) or isinstance(model, DistanceModel):
        return None
    parts = [_attained(model, attained) for attained in (data.calibration, data.held_out) if attained is not None]
    attained = _joined(parts)
    groups = _groups(attained, model, tables)
    rng, rows = np.random.default_rng(_SEED), list[TableRow]()
    channels = model.channels
    for k, turned in enumerate(channels.is_rotation):
        if turned and data.calibration.frames.free:
            continue  # each pose has a frame of its own, by the targets of another link
        name = channels.links[k] if channels.names[k] in ("position", "orientation") else ""
        subject = name or f"{channels.links[k]} {channels.names[k]}"
        for group in groups:
            if len(is_observed := group[attained.is_observed[group, k]]) < 2:
                continue
            figures = [*_of_pose(attained, k, is_observed, rng)]
            if len(is_observed) >= 2 * _OF_LOOK:
                figures += _drift(attained, k, _in_time(attained, is_observed), rng)
            rows += _rows(subject, (attained.poses[int(group[0])], None), len(is_observed), figures)
        for pair in _far_pairs(attained, groups):
            first, second = (_in_time(attained, group[attained.is_observed[group, k]]) for group in pair)
            count = min(len(first), len(second))
            if count >= FEWEST:
                figures = [*_of_distance(attained, k, first[:count], second[:count])]
                poses = attained.poses[int(pair[0][0])], attained.poses[int(pair[1][0])]
                rows += _rows(subject, poses, count, figures)
    return identified_table("arm_accuracy", rows, "pose", ("other_pose", "low", "high")) if rows else None


def _rows(
    subject: str, poses: tuple[int | str, int | str | None], attained: int, figures: list[tuple[str, Figure]]
) -> Iterator[TableRow]:
    """Rows of the figures of a pose, or of the distance of two; those about an axis are angles."""
    for figure, value in figures:
        unit, si = ("arcsec", _ARCSEC) if "_" in figure else ("um", _UM)
        other = None if poses[1] is None else str(poses[1])
        first = {"subject": subject, "pose": poses[0], "other_pose": other, "attained": attained, "unit": unit}
        low, high = (None if np.isnan(end) else end / si for end in (value.low, value.high))
        yield {**first, "figure": figure, "value": value.value / si, "low": low, "high": high}


def _attained(model: ChainModel, epochs: Epochs) -> _Attained:
    """Attained and commanded values of some poses."""
    plain = model.at(replace(epochs.conditions, coupling=None))
    frames, measured = epochs.frames, epochs.measured
    values = np.einsum("bji,bkj->bki", frames.R, measured.values - frames.t[:, None])
    commanded = plain.points(np.zeros(plain.shared_size), np.zeros((len(values), plain.local_size)))
    turned = model.channels.is_rotation
    deviation = np.where(turned[:, None], -commanded, values - commanded)
    conditions = epochs.conditions
    covariates = conditions.covariates
    approach = covariates.get(APPROACH, np.ones_like(conditions.readings))
    return _Attained(
        conditions.poses,
        conditions.series,
        np.asarray(covariates[ORDER], float),
        conditions.readings,
        approach,
        values,
        commanded,
        deviation,
        conditions.reference,
        measured.is_observed,
        turned,
    )


def _joined(parts: list[_Attained]) -> _Attained:
    names = ("series", "order", "readings", "approach", "attained", "commanded", "deviation", "turned", "is_observed")
    poses = tuple(pose for part in parts for pose in part.poses)
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return _Attained(poses, **joined, is_rotation=parts[0].is_rotation)


def _groups(attained: _Attained, model: ChainModel, tables: Mapping[str, pa.Table]) -> list[Index]:
    """Repeated poses of one series: those that repeat_of names, else those of equal readings of all joints."""
    table = tables.get("configurations")
    if table is not None and DECLARED in table.column_names:
        index_of, names = {pose: at for at, pose in enumerate(attained.poses)}, pose_ids(table)
        groups_by_name = [
            [index_of[names[row]] for row in group if names[row] in index_of] for group in declared_repeats(table)
        ]
        groups = [np.array(group, np.int64) for group in groups_by_name]
    else:
        groups = repeated_groups(attained.readings, np.maximum(_SAME * model.known.reading_sigma, _ROUNDING))
    parts = [
        group[attained.series[group] == number] for group in groups for number in np.unique(attained.series[group])
    ]
    return [part for part in parts if len(part) > 1]


def _in_time(attained: _Attained, rows: Index) -> Index:
    return rows[np.argsort(attained.order[rows], kind="stable")]


def _far_pairs(attained: _Attained, groups: list[Index]) -> list[tuple[Index, Index]]:
    """Pairs of repeated poses for distances: each with the one of its series whose commanded position is farthest."""
    enough = [group for group in groups if len(group) >= FEWEST]
    if not enough or attained.is_rotation.all():
        return []
    first = np.array([group[0] for group in enough])
    places, series = attained.commanded[first][:, ~attained.is_rotation].mean(1), attained.series[first]
    apart = np.linalg.norm(places[:, None] - places, axis=-1) * (series[:, None] == series)
    farthest = apart.argmax(1)
    pairs = {
        (min(pose, far_pose), max(pose, far_pose))
        for pose, far_pose in enumerate(farthest.tolist())
        if apart[pose, far_pose]
    }
    return [(enough[pose], enough[far_pose]) for pose, far_pose in sorted(pairs)]


def _of_distance(attained: _Attained, k: int, first: Index, second: Index) -> _Figures:
    """AD and RD of two repeated poses, the n-th repeat of one with the n-th of the other."""
    if attained.is_rotation[k]:
        figures = orientation_distance_figures(attained.deviation[first, k], attained.deviation[second, k])
        for axis, (accuracy, repeatability) in zip(_AXES, figures, strict=True):
            yield f"AD_{axis}", accuracy
            yield f"RD_{axis}", repeatability
        return
    commanded = np.linalg.norm(attained.commanded[second, k] - attained.commanded[first, k], axis=1)
    places = attained.attained[:, k]
    accuracy, repeatability = distance_figures(places[first], places[second], float(commanded.mean()))
    yield "AD", accuracy
    yield "RD", repeatability


def _drift(attained: _Attained, k: int, rows: Index, rng: np.random.Generator) -> _Figures:
    """Largest change of AP and RP between the first look, of ten repeats, and a later one; rows in order of time."""
    looks = [rows[start : start + _OF_LOOK] for start in range(0, len(rows) - _OF_LOOK + 1, _OF_LOOK)]
    figures_by_look = [{name: figure.value for name, figure in _of_pose(attained, k, look, rng)} for look in looks]
    for name in figures_by_look[0]:
        if not name.startswith("v"):
            yield f"d{name}", _alone(largest_change([figures[name] for figures in figures_by_look]))


def _of_pose(attained: _Attained, k: int, rows: Index, rng: np.random.Generator) -> _Figures:
    return _of_orientation(attained, k, rows) if attained.is_rotation[k] else _of_position(attained, k, rows, rng)


def _of_position(attained: _Attained, k: int, rows: Index, rng: np.random.Generator) -> _Figures:
    off, places = attained.deviation[rows, k], attained.attained[rows, k]
    yield "AP", _alone(float(np.linalg.norm(off.mean(0))))
    if len(rows) >= FEWEST:
        yield "RP", position_repeatability(places, rng)
    means = _by_approach(attained, rows, off)
    if len(means) > 1:
        yield "vAP", _alone(largest_distance(means))


def _of_orientation(attained: _Attained, k: int, rows: Index) -> _Figures:
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
