"""Do loads, readings and signals of a force sensor belong together; and slips in the description of its legs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, cast

import numpy as np

from truing.arrays import Array
from truing.belonging.bench_descriptions import DescribedBench, with_described
from truing.belonging.load_tests import MILLIVOLT, KnownBench, relate_loads
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import (
    DISPLACEMENT_UNITS,
    FRINGE_SHARES,
    ROTATION_UNITS,
    RecordSlip,
    RelationTest,
    SlipKind,
)
from truing.estimation.interferometry.recorded_steps import CHANNELS, READING_SI, RecordedSteps
from truing.schemas.interferometer import LINEAR
from truing.simulation.bench.six_upur.geometry import JointCentres, joint_centres
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.stages.common.beam_rows import channel_rows
from truing.stages.common.reading_arrays import LOAD_COLUMNS
from truing.stages.common.sensor_elements import elastic_parts, sensor_joints

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism

_LEGS, _MM = 6, 1e-3
_SINGULAR = 1e12  # condition of the legs' influence, from which on legs do not carry every load
_LENGTHS = (1e3, 25.4)  # m and inches in place of mm
_SIZES = (2.0, 0.5)  # a radius in place of a diameter, and the other way
_MECHANISM = "of [mechanism]"
# Axes whose loads, with the opposite sign, have the same signals: platform and base exchanged mirror z, and so on.
_AS_LOADS = {
    SlipKind.PARTS_EXCHANGED: ("fz", "mx", "my"),
    SlipKind.MIRRORED: ("fy", "mx", "mz"),
    SlipKind.SIGN: ("fx", "fy", "mx", "my"),
}


def relations_of_loads(steps: RecordedSteps, compliance: Array | None, settings: Campaign) -> tuple[RelationTest, ...]:
    """Return the tested relations of a loading campaign; ``compliance`` (6, 6): as simulated, in terms of the
    channels."""
    count, sensitivity = len(steps.signals), settings.signals.sensitivity_mv_per_n
    gain = leg_forces = None
    if sensitivity is not None and np.size(sensitivity) in (1, count):
        gain = np.broadcast_to(np.asarray(sensitivity, float), count) * MILLIVOLT
    sensor = cast("SensorMechanism", settings.mechanism) if settings.mechanism.type == "6-upur" else None
    if sensor is not None and count == _LEGS:
        leg_forces = _leg_forces(sensor)
    largest = np.array([getattr(settings.loading, name) or np.nan for name in LOAD_COLUMNS], float)
    noise, tared = settings.noise.signal_mv or np.nan, settings.signals.zero_mv is not None
    known = KnownBench(_channels(settings), compliance, leg_forces, gain, largest, noise, tared)
    tests = relate_loads(steps, known)
    return tests if sensor is None else with_described(tests, steps, known, _described(sensor, settings, known))


def _leg_forces(sensor: SensorMechanism, joints: JointCentres | None = None) -> Array | None:
    """Return the leg forces (6, 6) per unit load; None if the legs do not carry every load."""
    elastic = elastic_parts(sensor, joints)
    if elastic is not None:
        return np.asarray(elastic.axial_forces)
    G = influence_matrix(joints or sensor_joints(sensor))
    return np.asarray(np.linalg.inv(G)) if np.linalg.cond(G) < _SINGULAR else None


def _described(sensor: SensorMechanism, settings: Campaign, known: KnownBench) -> Iterator[DescribedBench]:
    """Yield the declared legs without a slip each; none that the elements do not fit."""
    beams = channel_rows(settings.interferometer.beams)
    for slip, joints in _otherwise(sensor):
        try:
            elastic = elastic_parts(sensor, joints)
            forces = None if known.leg_forces is None else _leg_forces(sensor, joints)
        except (ValueError, np.linalg.LinAlgError):
            continue
        compliance = known.compliance if elastic is None else np.asarray(beams @ elastic.compliance)
        axes = _AS_LOADS.get(slip.kind)
        as_loads = None if axes is None else RecordSlip(SlipKind.SIGN, "load", axes)
        yield DescribedBench(slip, as_loads, compliance, forces)


def _otherwise(sensor: SensorMechanism) -> Iterator[tuple[RecordSlip, JointCentres]]:
    """Yield slips with the joint centres without them, m."""
    lower, upper = (_MM * np.array([getattr(leg, name) for leg in sensor.legs]) for name in ("B_mm", "b_mm"))
    height, mirror = _MM * sensor.height_mm, np.array([1.0, -1.0, 1.0])
    both, joints = "B_mm and b_mm", f"joints {_MECHANISM}"
    yield RecordSlip(SlipKind.PARTS_EXCHANGED, joints, ("B_mm", "b_mm")), joint_centres(upper, lower, height)
    slip = RecordSlip(SlipKind.MIRRORED, f"{both} {_MECHANISM}")
    yield slip, joint_centres(lower * mirror, upper * mirror, height)
    turn = np.array([-1.0, -1.0, 1.0])
    slip = RecordSlip(SlipKind.SIGN, f"x and y of {both} {_MECHANISM}")
    yield slip, joint_centres(lower * turn, upper * turn, height)
    for degrees, quarter in ((90, np.array([[0.0, -1.0], [1.0, 0.0]])), (-90, np.array([[0.0, 1.0], [-1.0, 0.0]]))):
        quarter_turn = np.eye(3)
        quarter_turn[:2, :2] = quarter
        slip = RecordSlip(SlipKind.COLUMNS, f"x and y of {both} {_MECHANISM}", (f"turn by {degrees} degrees about z",))
        yield slip, joint_centres(lower @ quarter_turn.T, upper @ quarter_turn.T, height)
    for shift in range(1, _LEGS):
        slip = RecordSlip(SlipKind.COLUMNS, f"signals against legs {_MECHANISM}", (f"legs moved on by {shift}",))
        yield slip, joint_centres(np.roll(lower, shift, axis=0), np.roll(upper, shift, axis=0), height)
    for shift in (1, -1):
        slip = RecordSlip(SlipKind.COLUMNS, f"b_mm {_MECHANISM} against B_mm", (f"legs moved on by {shift}",))
        yield slip, joint_centres(lower, np.roll(upper, shift, axis=0), height)
    for factor in _LENGTHS:
        slip = RecordSlip(SlipKind.UNIT, f"{both} {_MECHANISM}", (), factor)
        yield slip, joint_centres(factor * lower, factor * upper, height)
        yield RecordSlip(SlipKind.UNIT, "height_mm", (), factor), joint_centres(lower, upper, factor * height)
        slip = RecordSlip(SlipKind.UNIT, f"{both}, height_mm {_MECHANISM}", (), factor)
        yield slip, joint_centres(factor * lower, factor * upper, factor * height)
    for factor in _SIZES:
        yield RecordSlip(SlipKind.UNIT, f"B_mm {_MECHANISM}", (), factor), joint_centres(factor * lower, upper, height)
        yield RecordSlip(SlipKind.UNIT, f"b_mm {_MECHANISM}", (), factor), joint_centres(lower, factor * upper, height)


def _channels(settings: Campaign) -> list[RecordedColumn]:
    """Return the interferometer channels with their quantities and plausible other units."""
    wave_um = settings.interferometer.wavelength_nm * 1e-3
    fringes = tuple(share * wave_um for share in FRINGE_SHARES)
    return [
        RecordedColumn(name, "displacement", DISPLACEMENT_UNITS, fringes, float(READING_SI[k]))
        if name in LINEAR
        else RecordedColumn(name, "rotation", ROTATION_UNITS, (), float(READING_SI[k]))
        for k, name in enumerate(CHANNELS)
    ]
