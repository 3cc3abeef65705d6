"""Data of the diagnosis of an open chain: targets or poses of its links, and the readings of its joints."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.estimation.rotation import skew
from truing.inference.arrays import Integers
from truing.inference.blocks import BlockKind
from truing.inference.observations import Epochs, Frames, Observations
from truing.report.numbers import count_text
from truing.schemas.verdict import Relation
from truing.simulation.mechanisms.chains.causes import ChainCause, JointOffset, JointsExchanged
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree
from truing.simulation.mechanisms.chains.column_slips import ColumnSlip, ColumnSlipKind, foreign_misfit, likely_slip
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.distances import DistanceModel
from truing.simulation.mechanisms.chains.joint_zeros import offsets_beyond_tolerance
from truing.simulation.mechanisms.chains.measured_lines import fitted_places, lines_at, with_ground
from truing.simulation.mechanisms.chains.model import FREE_PLACE, ChainModel, KnownChain
from truing.simulation.mechanisms.chains.motor_encoders import MotorTerm, motor_terms
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import TWIST, JointKind, Tree, geometry_modes
from truing.simulation.targets import FREE_ANGLE_RAD, FREE_LENGTH_M
from truing.stages.common.blocks import groupings_of, labels_of, selected_groupings
from truing.stages.common.chain_distances import fit_of_distances, is_station, measured_distances
from truing.stages.common.chain_gross_errors import gross_errors
from truing.stages.common.chain_measurements import (
    MeasuredLinks,
    chain_conditions,
    excluded_poses,
    is_framed,
    measured_links,
    reference_link,
)
from truing.stages.common.chain_start import nominal_fit, tolerated_misfit
from truing.stages.common.chain_tables import joint_readings, motor_readings, tree_of
from truing.stages.common.missing_data import HELD_OUT, LEAST_POSES_OF_CHAIN
from truing.stages.common.point_arrays import pose_ids, roles_of
from truing.stages.diagnosis.chain_distances import with_distances, with_places
from truing.stages.diagnosis.chain_results import results, text_of_model
from truing.stages.diagnosis.diagnosis_data import Channels, DiagnosisData, ReportedRms

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.chain_mechanism import ChainMechanism

_DEG, _MM = np.pi / 180.0, 1e-3
_ARCSEC = _DEG / 3600.0
# Measured numbers that a search uses at most, and poses in any case, so that memory and time stay bounded.
_MOST_NUMBERS, _ALWAYS = 4500, 500
# Up to this many poses, exact readings have a noise of this share of the points' noise: joints may scatter.
_FEW_POSES, _HARDLY = 400, 0.2
_DRIVE = "the joint readings"
_SLIPS = {
    ColumnSlipKind.REVERSED: "the sign of {} reversed",
    ColumnSlipKind.DEGREES: "the readings of {} taken as degrees",
    ColumnSlipKind.RADIANS: "the readings of {} taken as radians",
    ColumnSlipKind.GON: "the readings of {} taken as gon",
    ColumnSlipKind.ADDED: "the readings of the first of {} added to those of the second",
    ColumnSlipKind.SUBTRACTED: "the readings of the first of {} subtracted from those of the second",
    ColumnSlipKind.DOWN: "the readings of {} one row higher",
    ColumnSlipKind.UP: "the readings of {} one row lower",
    ColumnSlipKind.UPSIDE_DOWN: "the readings of {} in reversed order of rows",
}


def assemble(tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData[ChainModel]:
    """Data of the diagnosis; raises ValueError with the reason if the campaign lacks them."""
    tree, table = tree_of(tables["joints"]), tables["configurations"]
    poses = pose_ids(table)
    of_distances = "distances" in tables and tables["distances"].num_rows > 0
    tree = with_ground(tree) if of_distances else tree
    of_links = any(name in tables and tables[name].num_rows for name in ("observations", "measured_poses"))
    points = None
    if of_links or not of_distances:
        points = _filled(measured_links(tables, tree, poses, gross_errors)).decoupled()
    lines = _filled(measured_distances(tables, tree, poses)) if of_distances else None
    measured = with_distances(points, lines)
    readings = joint_readings(tree, table)
    reference = None if points is None else reference_link(settings, points)
    out, read = excluded_poses(settings.exclude, poses), np.asarray(np.isfinite(readings).all(1))
    framed = is_framed(points or measured, reference)
    usable = read & measured.is_observed.any(1) & ~out & framed
    if usable.sum() < LEAST_POSES_OF_CHAIN:
        raise ValueError(f"needs at least {LEAST_POSES_OF_CHAIN} poses with readings of all joints and measured links")
    conditions = chain_conditions(tree, table, settings, measured.reference, readings, usable, measured.coupling)
    role = roles_of(table, poses)
    fitted, held_out = usable & (role != HELD_OUT), usable & (role == HELD_OUT)
    if fitted.sum() < LEAST_POSES_OF_CHAIN:
        raise ValueError(f"needs at least {LEAST_POSES_OF_CHAIN} poses that may be fitted, found {int(fitted.sum())}")
    searched, tested = (_thinned(rows, measured) for rows in (fitted, held_out))
    if lines is not None and points is not None:
        frames, model, certain = _mixed_model(tree, settings, points, measured, conditions, searched)
    else:
        build = _distance_model if of_distances else _model
        frames, model, certain = build(tree, settings, measured, conditions, searched)
    right = model.at(conditions.subset(searched)).with_causes(certain)
    every = _Poses(model, measured, frames, labels_of(table, poses))
    evident: tuple[ChainCause, ...] = certain
    start = every.fitted(searched)
    evident += offsets_beyond_tolerance(right, start.measured, start.frames)
    data = DiagnosisData(
        model.at(conditions.subset(searched)),
        start,
        every.epochs(tested) if tested.any() else None,
        _omissions(out, read, framed, (_fewer(searched, fitted, "pose"), _fewer(tested, held_out, "held-out pose"))),
        partial(
            results,
            series=_labels(table),
            motors=_motors(right, table, searched),
            tables={"joints": tables["joints"], "configurations": table},
        ),
        evident,
        model_text=text_of_model,
        shown=_shown(model),
        relation=Relation.JOINTS_LINKS,
    )
    if np.array_equal(searched, fitted) and np.array_equal(tested, held_out):
        return data
    whole = replace(
        data,
        model=model.at(conditions.subset(fitted)),
        calibration=every.fitted(fitted),
        held_out=every.epochs(held_out) if held_out.any() else None,
    )
    return replace(data, every_epoch=whole)


@dataclass(frozen=True)
class _Poses:
    """All poses (B,) of a campaign: model, measured links, frames, and labels by which poses can be left out."""

    model: ChainModel
    measured: MeasuredLinks
    frames: Frames
    labels: Mapping[BlockKind, Integers]

    def epochs(self, rows: Mask) -> Epochs[ChainConditions]:
        """Some of the poses (B,)."""
        measured = self.measured
        observed = Observations(measured.values[rows], measured.cov[rows], measured.is_observed[rows])
        frames = Frames(self.frames.R[rows], self.frames.t[rows], self.frames.free)
        return Epochs(observed, self.model.conditions.subset(rows), frames)

    def fitted(self, rows: Mask) -> Epochs[ChainConditions]:
        """Some of the poses (B,), with the groupings in which they can be left out."""
        epochs, labels = self.epochs(rows), selected_groupings(self.labels, rows)
        time = epochs.conditions.covariates.get("time_s")
        return replace(epochs, groupings=groupings_of(epochs.conditions.readings, time, None, labels))


def _omissions(out: Mask, read: Mask, framed: Mask, thinned: Sequence[str]) -> str:
    """Poses (B,) that are not searched, in words."""
    unread, loose = int((~read).sum()), int((~framed).sum())
    words = (
        f"{count_text(int(out.sum()), 'pose')} excluded by a person" if out.any() else "",
        f"{count_text(unread, 'pose')} without a reading of every joint" if unread else "",
        f"{count_text(loose, 'pose')} with too few targets of the reference link" if loose else "",
        *thinned,
    )
    return "; ".join(filter(None, words))


def _filled(measured: MeasuredLinks) -> MeasuredLinks:
    """The channels, whose unseen observations have the mean covariance of their channel: it must not be singular."""
    cov = measured.cov.copy()
    for k, is_observed in enumerate(measured.is_observed.T):
        if is_observed.any():
            cov[~is_observed, k] = cov[is_observed, k].mean(0)
    return replace(measured, cov=cov)


def _shown(model: ChainModel) -> ReportedRms | Channels:
    turned = model.is_angle
    if not turned.any():
        noun = "point"
        if isinstance(model, DistanceModel):
            noun = "measured number" if len(model.coordinates) else "distance"
        return ReportedRms(drive=_DRIVE, what=noun)
    return Channels(
        tuple("arcsec" if is_turned else "um" for is_turned in turned),
        np.where(turned, _ARCSEC, 1e-6),
        np.zeros(len(turned), bool),
        epoch="pose",
        fitted="the calibration poses",
        held_out="held-out poses",
        drive=_DRIVE,
        scatter="Measure one pose ten times without moving anything: the scatter is the true noise.",
        what="pose component",
    )


def _thinned(rows: Mask, measured: MeasuredLinks) -> Mask:
    """Poses (B,) of these that are searched, evenly over the campaign."""
    count = int(rows.sum())
    numbers = int(measured.is_observed[rows].sum()) * measured.values.shape[2]
    most = max(_ALWAYS, _MOST_NUMBERS * count // max(numbers, 1))
    if count <= most:
        return rows
    chosen = np.zeros_like(rows)
    chosen[np.flatnonzero(rows)[np.linspace(0, count - 1, most).round().astype(int)]] = True
    return chosen


def _fewer(searched: Mask, known: Mask, noun: str) -> str:
    """Poses (B,) that the search for causes does not take, in words."""
    count, used = int(known.sum()), int(searched.sum())
    return f"{count - used} of {count_text(count, noun)} in the search for causes" if used < count else ""


def _distance_model(
    tree: Tree, settings: Campaign, measured: MeasuredLinks, conditions: ChainConditions, fitted: Mask
) -> tuple[Frames, ChainModel, tuple[ChainCause, ...]]:
    """Frames without unknowns, and the model: the ground is the frame, in which stations have unknown places."""
    count, ends = len(measured.values), measured.ends
    assert ends is not None
    conditions = replace(conditions, series=np.zeros(count, np.int64))
    allowed = tolerated_misfit(tree, measured.channels.node, conditions.readings[fitted], settings)
    start_of = fit_of_distances(tree, measured, conditions, fitted).start_of
    start, certain, _ = _started(tree, conditions, start_of, allowed)
    reach = float(np.sqrt(np.mean(tree.frames(conditions.readings[fitted]).t ** 2)))
    known = _known(tree, settings, measured, replace(start, spread=reach), False)
    return Frames.of_numbers(count), DistanceModel(tree, measured.channels, known, conditions, ends=ends), certain


def _mixed_model(
    tree: Tree,
    settings: Campaign,
    points: MeasuredLinks,
    measured: MeasuredLinks,
    conditions: ChainConditions,
    fitted: Mask,
) -> tuple[Frames, ChainModel, tuple[ChainCause, ...]]:
    """Frames without unknowns, and the model of points or poses next to distances.

    Places that points determine start from these; stations, and targets that only distances reach, from distances.
    """
    assert measured.ends is not None
    assert measured.coordinates is not None
    of_points = replace(conditions, reference=points.reference)
    nominal = nominal_fit(tree, settings, points, of_points, fitted)
    allowed = tolerated_misfit(tree, points.channels.node, conditions.readings[fitted], settings)
    start, certain, right = _started(tree, of_points, nominal.start_of, allowed)
    stations = is_station(measured)
    if nominal.reference is not None or (stations.any() and len(start.base_t) > 1):
        raise ValueError(
            "distances beside points or poses need an instrument that stood still, with stations in the whole "
            'campaign: [measurement] frame = "campaign"'
        )
    known = _known(tree, settings, measured, with_places(start, measured), True)
    free = DistanceModel(tree, measured.channels, known, conditions, ends=measured.ends)
    free = replace(free, coordinates=measured.coordinates)
    subset, first, count = right.subset(fitted), len(measured.coordinates), len(points.channels.names)
    lines = lines_at(
        tree,
        measured.channels.node,
        measured.ends,
        subset,
        measured.values[fitted, first:, 0],
        measured.is_observed[fitted, first:],
        (known.base_R, known.base_t),
    )
    unknown = np.flatnonzero(~np.isfinite(measured.surveyed).all(1))
    shape = fitted_places(lines, known.shape, unknown[unknown >= count], stations)
    return Frames.of_numbers(len(measured.values)), replace(free, known=replace(known, shape=shape)), certain


def _motors(model: ChainModel, table: pa.Table, fitted: Mask) -> list[MotorTerm]:
    """Terms of every motor encoder that the campaign has, over the poses that are searched."""
    readings = motor_readings(model.tree, table)
    return [
        term for k, motor_reading in readings.items() for term in motor_terms(model.machine, k, motor_reading[fitted])
    ]


def _labels(table: pa.Table) -> dict[int | str, str]:
    """Label of the series of each pose that has one."""
    if "series" not in table.schema.names:
        return {}
    series_by_pose = zip(table.column("pose").to_pylist(), table.column("series").to_pylist(), strict=True)
    return {pose: str(label) for pose, label in series_by_pose if label}


def _model(
    tree: Tree, settings: Campaign, measured: MeasuredLinks, conditions: ChainConditions, fitted: Mask
) -> tuple[Frames, ChainModel, tuple[ChainCause, ...]]:
    """Frames of all poses, the model, and causes that are certain before any search.

    In frames of single poses a measured link is the reference.
    """
    nominal = nominal_fit(tree, settings, measured, conditions, fitted)
    frames = Frames(nominal.R, nominal.t, free=nominal.reference is not None)
    allowed = tolerated_misfit(tree, measured.channels.node, conditions.readings[fitted], settings)
    start, certain, _ = _started(tree, conditions, nominal.start_of, allowed)
    if nominal.reference is not None and not nominal.is_base_known:
        # The measured shape of the reference link, in the base's frame, is the frame of the model.
        R, t = start.base_R[0], start.base_t[0]
        frames = Frames(frames.R @ R, frames.t + frames.R @ t, free=True)
        start = replace(start, base_R=np.eye(3)[None], base_t=np.zeros((1, 3)))
    known = _known(tree, settings, measured, start, nominal.reference is None)
    return frames, ChainModel(tree, measured.channels, known, conditions), certain


def _started(
    tree: Tree,
    conditions: ChainConditions,
    start_of: Callable[[Mask, ChainConditions], StartValues],
    tolerated: float,
) -> tuple[StartValues, tuple[ChainCause, ...], ChainConditions]:
    """Start values, causes without which readings and measurement do not join, and the conditions without them.

    These are two exchanged columns, or zeros of joints that are far off; a misfit, m, that is ``tolerated`` needs none.
    Raises ValueError, with the likely slip, where nothing joins them.
    """
    every = np.ones(len(conditions.readings), bool)
    start = start_of(every, conditions)
    if start.rms <= max(foreign_misfit(start), tolerated):
        return start, (), conditions
    slip = likely_slip(conditions, tree.is_revolute, start_of)
    certain = _certain(tree, slip, start)
    assert slip is not None
    right = replace(conditions, readings=slip.corrected(conditions.readings))
    return start_of(every, right), certain, right


def _certain(tree: Tree, slip: ColumnSlip | None, start: StartValues) -> tuple[ChainCause, ...]:
    """The causes of a slip that the diagnosis can correct; raises ValueError, with the likely slip, for others."""
    missed = (
        f"the nominal chain misses the measured places by {start.rms / _MM:.3g} mm rms of {start.spread / _MM:.3g} mm"
    )
    if slip is None:
        raise ValueError(
            f"joint readings and measured links do not belong together: {missed}. Check the columns of the joints, "
            "their units and signs, the robot description, and the names of the poses"
        )
    names = [tree.readings[k] for k in slip.readings]
    if slip.kind is ColumnSlipKind.EXCHANGED:
        return (JointsExchanged(tuple(names)),)
    if slip.kind is ColumnSlipKind.ZEROS:
        zeros = zip(names, tree.is_revolute[list(slip.readings)], slip.offsets, strict=True)
        return tuple(JointOffset(name, bool(turns), offset) for name, turns, offset in zeros)
    whose = " and ".join(f"joint {name}" for name in names)
    raise ValueError(
        f"{missed}, and {slip.after / _MM:.3g} mm with {_SLIPS[slip.kind].format(whose)}. Correct the column, "
        "or the robot description"
    )


def _known(
    tree: Tree, settings: Campaign, measured: MeasuredLinks, start: StartValues, is_base_free: bool
) -> KnownChain:
    """Prior knowledge of the chain, by the tolerances and noise of campaign.toml."""
    section, channels = cast("ChainMechanism", settings.mechanism), measured.channels
    tolerance = section.tolerance
    lengths = FREE_LENGTH_M if tolerance.length_mm is None else tolerance.length_mm * _MM
    angles = FREE_ANGLE_RAD if tolerance.angle_deg is None else tolerance.angle_deg * _DEG
    sigma = np.array([lengths] * 3 + [angles] * 3)
    offsets = np.where(
        tree.is_revolute,
        (tolerance.offset_deg or 0.0) * _DEG,
        (tolerance.length_mm or 0.0 if tolerance.offset_mm is None else tolerance.offset_mm) * _MM,
    )
    noise = np.where(tree.is_revolute, settings.noise.joint_deg * _DEG, settings.noise.joint_mm * _MM)
    noise = np.maximum(noise, _least_noise(tree, measured, start)) if len(measured.values) <= _FEW_POSES else noise
    is_base_seen = bool((channels.node == 0).any())
    is_surveyed = np.asarray(np.isfinite(measured.surveyed).all(1))
    base_known = is_base_seen and bool(is_surveyed[channels.node == 0].all())
    is_toleranced = np.repeat([tolerance.length_mm is not None, tolerance.angle_deg is not None], TWIST // 2)
    is_known = bool(is_toleranced.any())
    modes, known, ends = _shape_modes(measured, tree, sigma if is_known else None)
    last = max(k for k, node in enumerate(tree.nodes) if node.parent >= 0)
    tip = tree.links.get(section.tip or "", last)
    return KnownChain(
        start.base_R,
        start.base_t,
        is_base_free,
        _geometry(tree, sigma, not base_known, is_toleranced, set(channels.node[is_surveyed].tolist())),
        is_known,
        offsets.astype(float),
        start.shape,
        modes,
        known,
        start.tool,
        noise.astype(float),
        None if section.gravity is None else np.array(section.gravity, float),
        (tip, np.array(section.payload_com_mm or (0.0, 0.0, 0.0), float) * _MM),
        _without_centre(tree, tip, section),
        section.reference_temperature_c,
        {**section.gear_orders, **_of_pitches(section.pitch_mm)},
        ends,
    )


def _without_centre(tree: Tree, tip: int, section: ChainMechanism) -> tuple[str, ...]:
    """Links of which campaign.toml gives a mass without its centre; the tip, unless that of the payload is given."""
    rows: Sequence[Any] = section.dh or section.screws
    links = [
        node.link
        for node, row in zip(tree.nodes[1 : 1 + len(rows)], rows, strict=True)
        if row.mass_kg > 0.0 and row.com_mm is None
    ]
    return (*links, tree.nodes[tip].link) if section.payload_com_mm is None else tuple(links)


def _of_pitches(pitches: Mapping[str, Sequence[float]]) -> dict[str, tuple[float, ...]]:
    """2 pi over each period, rad/m, by slide, of periods in mm."""
    return {joint: tuple(2.0 * np.pi / (_MM * period) for period in periods) for joint, periods in pitches.items()}


def _geometry(tree: Tree, sigma: NDArray, is_base_free: bool, known: Mask, placed: Collection[int]) -> Array:
    """Twists (N, 6, Q) per prior sigma of all distinguishable errors of the links, those in loops included.

    ``placed``: nodes with targets of known place.
    """
    modes = geometry_modes(tree, sigma, is_base_free, known, placed)
    if isinstance(tree, ClosedTree):
        zeros = np.moveaxis(tree.axis_twists, 0, -1)
        others = zeros[..., :0] if known.any() else np.concatenate([zeros, modes], -1)
        modes = np.concatenate([modes, tree.closing_modes(sigma, others)], -1)
    return modes


def _least_noise(tree: Tree, measured: MeasuredLinks, start: StartValues) -> Array:
    """Noise (n,) of the readings, rad or m, that hardly shows in the measured places: the scale of joint scatter."""
    positions = measured.is_position
    is_observed = measured.is_observed[:, positions]
    if not is_observed.any():
        return np.zeros(len(tree.readings))
    variance = np.trace(measured.cov[:, positions][is_observed], axis1=-2, axis2=-1) / measured.values.shape[-1]
    size = _HARDLY * float(np.sqrt(np.median(variance)))
    return np.where(tree.is_revolute, size / max(start.spread, size), size)


def _shape_modes(measured: MeasuredLinks, tree: Tree, tolerance: NDArray | None) -> tuple[Array, Mask, Array]:
    """Errors of the channels' places per prior sigma (K, 3, W), and which priors are knowledge (W,).

    A surveyed target is known to its survey's noise, and its link's end to the tolerance of the geometry; the place of
    any other target or tool is free. Then the twists (N, 6, W) of fixed nodes that the errors of such ends amount to.
    """
    count = len(measured.channels.names)
    surveyed = np.asarray(np.isfinite(measured.surveyed).all(1))
    columns: list[Array] = []
    known: list[bool] = []
    ends: list[tuple[int, int]] = []
    for k in range(count):
        covariance_of_pose = np.zeros((count, 3, 3))
        free = FREE_PLACE * np.eye(3)
        covariance_of_pose[k] = np.linalg.cholesky(measured.survey_cov[k] + 1e-18 * np.eye(3)) if surveyed[k] else free
        columns.append(covariance_of_pose)
        known += [bool(surveyed[k])] * 3
    for node in map(int, np.unique(measured.channels.node[surveyed])) if tolerance is not None else ():
        if node == 0:
            continue
        moved = np.zeros((count, 3, 6))
        for own_k in np.flatnonzero(surveyed & (measured.channels.node == node)):
            moved[own_k] = np.concatenate([np.eye(3), -skew(measured.surveyed[own_k])], 1) * tolerance
        columns.append(moved)
        ends.append((node, len(known)))
        known += [True] * TWIST
    twists = np.zeros((tree.size, TWIST, len(known)))
    for node, first in ends:
        if tolerance is not None and tree.nodes[node].kind is JointKind.FIXED:
            twists[node, :, first : first + TWIST] = np.diag(tolerance)
    return np.concatenate(columns, -1), np.array(known, bool), twists
