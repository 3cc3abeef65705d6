"""Tables of the accuracy of the pose from that of the actuators: each component at its worst, legs, map."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.calibration.accuracy_map import AccuracyMap, accuracy_map
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.mechanisms.actuator_errors import QUANTITIES
from truing.simulation.mechanisms.parameters import ParameterSet
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.simulation.mechanisms.structures.structure import NO_CHANGE, Machine
from truing.stages.common.nominal_mechanism import FILE, plain_machine
from truing.stages.configurations.chosen import DesignOptions, DesignTables
from truing.stages.configurations.problem import limits_of, problem_of

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

_ARCSEC = np.pi / 180.0 / 3600.0
_POSE = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
_POSE_SI = np.array([1e-3] * 3 + [np.pi / 180.0] * 3)
# Position and its components in um, rotations in arc seconds.
_UNITS = ("um", "um", "um", "arcsec", "arcsec", "arcsec", "um", "arcsec")
_SI = np.array([1e-6 if unit == "um" else _ARCSEC for unit in _UNITS])
_OF_NOISE = np.sqrt(3.0)  # half width of an even distribution, in standard deviations


def accuracy_tables(settings: Campaign, options: DesignOptions, tables: DesignTables) -> dict[str, pa.Table]:
    """Return the tables by the ending of their file: worst (none), ``-legs``, ``-map`` and ``-jacobian``.

    Raises CampaignFaults.
    """
    machine = plain_machine(settings)
    accuracy, given_by = _accuracy(settings, machine.legs.count)
    limits = limits_of(
        settings, pose_too=options.within == "workspace", avoid=tables.avoid, avoid_file=tables.avoid_file
    )
    problem = problem_of(machine, limits, ParameterSet(()))
    try:
        found = accuracy_map(problem, accuracy, np.random.default_rng(options.seed))
    except ValueError as error:
        file = FILE if tables.avoid is None else tables.avoid_file
        raise CampaignFaults([Fault(file, str(error))]) from None
    tables_found = {"": _worst(found, settings), "-legs": _legs(found, given_by), "-map": _map(found)}
    return tables_found | {"-jacobian": _jacobian(machine, found)}


def _accuracy(settings: Campaign, legs: int) -> tuple[NDArray, str]:
    """Return +- of each actuator (L,), m, and the key that it follows from; raises CampaignFaults without either."""
    accuracies = cast("LeggedMechanism", settings.mechanism).actuator_accuracy_mm
    if accuracies is not None:
        return np.broadcast_to(np.asarray(accuracies, float) * 1e-3, legs), "mechanism.actuator_accuracy_mm"
    if settings.noise.actuator_mm:
        return np.full(legs, _OF_NOISE * settings.noise.actuator_mm * 1e-3), "noise.actuator_mm"
    expected = "the largest error of an actuator as specified, ±, one number or one per leg"
    raise CampaignFaults([Fault(FILE, expected, column="mechanism.actuator_accuracy_mm")])


def _worst(accuracy: AccuracyMap, settings: Campaign) -> pa.Table:
    worst_values = accuracy.worst, np.arange(len(QUANTITIES))
    errors = accuracy.errors
    columns: dict[str, object] = {
        "quantity": QUANTITIES,
        "unit": _UNITS,
        "worst": errors.worst[worst_values] / _SI,
        "sigma": errors.sigma[worst_values] / _SI,
        "at_reference": errors.worst[0] / _SI,
        "requirement": pa.array(_requirements(settings), pa.float64()),
        "part": [accuracy.part[k] for k in accuracy.worst],
    }
    return pa.table(columns | _poses(accuracy, accuracy.worst))


def _requirements(settings: Campaign) -> list[float | None]:
    """Return the limit of each quantity in its unit; None without one."""
    limits = [getattr(settings.requirement, name) for name in _POSE]
    si = zip(limits, _POSE_SI, _SI[: len(_POSE)], strict=True)
    return [*(None if limit is None else float(limit * factor / unit) for limit, factor, unit in si), None, None]


def _legs(accuracy: AccuracyMap, given_by: str) -> pa.Table:
    shares = accuracy.errors.shares[accuracy.worst, np.arange(len(QUANTITIES))]
    count = shares.shape[1]
    columns: dict[str, object] = {
        "quantity": np.repeat(QUANTITIES, count),
        "leg": np.tile(np.arange(count) + 1, len(QUANTITIES)),
        "share": shares.ravel(),
        "accuracy_um": np.tile(accuracy.accuracy * 1e6, len(QUANTITIES)),
        "accuracy_from": [given_by] * shares.size,
    }
    return pa.table(columns)


def _jacobian(machine: Machine, accuracy: AccuracyMap) -> pa.Table:
    """Return the change of each reading by a motion of the platform at the reference pose (telescope report,
    eq. 8)."""
    placed = accuracy.placed
    closing = structures(machine)[0].close(machine, placed.p[:1], placed.R[:1], placed.rho[:1], NO_CHANGE)
    slope = -np.linalg.solve(closing.by_rho[0], closing.by_twist[0]) * _POSE_SI * 1e3
    columns: dict[str, object] = {"leg": np.arange(len(slope)) + 1}
    units = (("mm",) * 3) + (("deg",) * 3)
    return pa.table(
        columns
        | {
            f"mm_per_{unit}_of_{name.partition('_')[0]}": slope[:, k]
            for k, (name, unit) in enumerate(zip(_POSE, units, strict=True))
        }
    )


def _map(accuracy: AccuracyMap) -> pa.Table:
    rows = np.arange(len(accuracy.part))
    errors = accuracy.errors.worst / _SI
    named = {
        f"{name}_error_{unit}": errors[:, k] for k, (name, unit) in enumerate(zip(QUANTITIES, _UNITS, strict=True))
    }
    columns: dict[str, object] = {"part": list(accuracy.part)}
    return pa.table(columns | _poses(accuracy, rows) | named)


def _poses(accuracy: AccuracyMap, rows: NDArray) -> dict[str, NDArray]:
    """Return the columns of configurations: displacement from the reference pose, and readings."""
    moved, rho = np.round(accuracy.moved[rows] / _POSE_SI, 6) + 0.0, np.round(accuracy.placed.rho[rows] * 1e3, 6)
    poses = dict(zip(_POSE, moved.T, strict=True))
    return poses | {f"rho{leg + 1}_mm": column for leg, column in enumerate(rho.T)}
