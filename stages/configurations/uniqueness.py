"""Tables of proofs by interval arithmetic over a machine's workspace: statements, range, and undecided parts."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.calibration.configuration_search import ConfigurationLimits, DesignProblem
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.mechanisms.legs.kinematics import leg_vectors, unit
from truing.simulation.mechanisms.parameters import ParameterSet
from truing.simulation.mechanisms.structures.beam_model import BETA, flexure_path
from truing.simulation.mechanisms.structures.structure import Machine
from truing.simulation.mechanisms.uniqueness import PROVABLE, Flexures, PoseBox, UniquenessProof, prove_uniqueness
from truing.stages.common.nominal_mechanism import FILE, nominal_machine, plain_machine
from truing.stages.configurations.chosen import DesignOptions, DesignTables
from truing.stages.configurations.problem import limits_of, problem_of

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

_POSE = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
_SI = np.array([1e-3] * 3 + [np.pi / 180.0] * 3)
_BEYOND = 1.01  # of the farthest corner, in displacements without a limit of their own
_LEAST_BEND, _STEPS = 1.0, 101  # degrees drawn at least, as in the telescope report's figure 9
_MOST_PARTS = 1000  # undecided parts in a table


def uniqueness_tables(settings: Campaign, options: DesignOptions, _: DesignTables) -> dict[str, pa.Table]:
    """Return the tables by the ending of their file: statements (none), ``-range``, ``-undecided``, and
    ``-flexures`` where the joints are flexures.

    Raises CampaignFaults for legs of another type than interval arithmetic covers, and for missing limits.
    """
    machine = plain_machine(settings)
    if machine.legs.closure.name not in PROVABLE:
        expected = f"{' or '.join(PROVABLE)}: interval arithmetic covers straight legs"
        raise CampaignFaults([Fault(FILE, expected, column="mechanism.type", value=machine.legs.closure.name)])
    limits = limits_of(settings, pose_too=options.within == "workspace", avoid=None, avoid_file="")
    problem = problem_of(machine, limits, ParameterSet(()))
    box, given_by = _box(problem, limits)
    flexures = _flexures_of(nominal_machine(cast("LeggedMechanism", settings.mechanism)))
    models = {machine.legs.closure.name: None} | ({} if flexures is None else {"beam": flexures})
    proofs = {name: prove_uniqueness(machine.legs, box, bending) for name, bending in models.items()}
    statements = {"": _statements(proofs), "-range": _range(box, given_by), "-undecided": _undecided(proofs)}
    return statements if flexures is None else {**statements, "-flexures": _flexures(flexures, _largest_bend(problem))}


def _box(problem: DesignProblem, limits: ConfigurationLimits) -> tuple[PoseBox, list[str]]:
    """Return the range of poses and readings, and the source of each of its 6 + L limits."""
    reference, machine = problem.regressors.reference, problem.regressors.machine
    x = problem.region.corners()
    reach = np.abs(problem.regressors.quantities(x)[0]).max(0) * _BEYOND
    declared = np.concatenate([limits.pose, limits.readings])
    known = np.isfinite(declared)
    half = np.where(known, declared, reach)
    box = PoseBox(reference.p[0], reference.R[0], half[:3], half[3:6], half[6:])
    assert len(half) == 6 + machine.legs.count
    return box, ["workspace" if is_given else "corners" for is_given in known]


def _largest_bend(problem: DesignProblem) -> float:
    """Return the largest bend of a flexure at the corners of the workspace, rad: the leg's rotation from its direction
    at the reference, seen from the base or from the platform."""
    regressors = problem.regressors
    placed, reference = regressors.at(problem.region.corners()), regressors.reference
    z = unit(leg_vectors(regressors.machine.legs, placed.p, placed.R, placed.rho))
    turned = reference.z @ reference.R @ np.swapaxes(placed.R, -1, -2)
    bends = [np.linalg.norm(z - direction, axis=-1) for direction in (reference.z, turned)]
    return float(2.0 * np.arcsin(0.5 * np.max(bends)))


def _statements(proofs: dict[str, UniquenessProof]) -> pa.Table:
    rows = []
    for model, proof in proofs.items():
        unique = "proven" if proof.unique else "not decided"
        regular = "proven" if proof.regular else "refuted" if proof.singular is not None else "not decided"
        common = {"model": model, "leg": None, "parts": proof.boxes, "slope_low": None, "slope_high": None}
        undecided = len(proof.undecided)
        rows.append({**common, "statement": "one pose", "state": unique, "undecided_parts": undecided})
        rows.append({**common, "statement": "no singular pose", "state": regular, "undecided_parts": None})
        for leg, (low, high) in enumerate(proof.reading_slope.tolist()):
            row_of_leg = {"leg": leg + 1, "slope_low": low, "slope_high": high, "parts": 1, "undecided_parts": None}
            state = "proven" if proof.inverse_unique[leg] else "not decided"
            rows.append({**common, **row_of_leg, "statement": "one reading", "state": state})
    names = ("statement", "model", "leg", "state", "parts", "undecided_parts", "slope_low", "slope_high")
    types = {"leg": pa.int64(), "parts": pa.int64(), "undecided_parts": pa.int64()}
    types |= {"slope_low": pa.float64(), "slope_high": pa.float64()}
    return pa.table({name: pa.array([row[name] for row in rows], types.get(name, pa.string())) for name in names})


def _range(box: PoseBox, given_by: list[str]) -> pa.Table:
    legs = len(box.readings)
    names = [*_POSE, *(f"rho{leg + 1}_mm" for leg in range(legs))]
    half = np.concatenate([box.position, box.rotation, box.readings]) / [*_SI, *([1e-3] * legs)]
    return pa.table({"coordinate": names, "half_range": half, "given_by": given_by})


def _flexures_of(machine: Machine) -> Flexures | None:
    if machine.flexure_length is None:
        return None
    beta = BETA if machine.beta is None else machine.beta
    return Flexures(machine.flexure_length, np.broadcast_to(beta, machine.flexure_length.shape))


def _flexures(flexures: Flexures, bend: float) -> pa.Table:
    """Return the path of the end of the longest flexure (telescope report, figure 9), um, across and towards its
    root."""
    longest = int(np.argmax(flexures.length))
    length, beta = float(flexures.length[longest]), float(flexures.beta[longest])
    path = flexure_path(length, np.radians(np.linspace(0.0, max(_LEAST_BEND, np.degrees(bend)), _STEPS)), beta)
    columns: dict[str, object] = {"bend_deg": np.degrees(path.slope)}
    for name, (along, across) in (("pivot", path.pivot), ("beam", path.beam), ("circle", path.circle)):
        columns |= {f"{name}_across_um": 1e6 * across, f"{name}_along_um": 1e6 * along}
    columns |= {"flexure_length_mm": np.full(_STEPS, 1e3 * length), "flexure_beta": np.full(_STEPS, beta)}
    return pa.table(columns | {"largest_bend_deg": np.full(_STEPS, np.degrees(bend))})


def _undecided(proofs: dict[str, UniquenessProof]) -> pa.Table:
    """Return ends of the parts without proof: displacement from the reference, rotations as vectors, the largest
    first."""
    models, parts = [], []
    for model, proof in proofs.items():
        undecided = proof.undecided[:_MOST_PARTS]
        models += [model] * len(undecided)
        parts.append(undecided)
    ends = np.concatenate(parts)
    angle = 2.0 * np.arctan(ends[..., 3:])  # of each axis alone
    ends = np.concatenate([ends[..., :3], angle], -1) / _SI
    columns: dict[str, object] = {"model": pa.array(models, pa.string())}
    for k, name in enumerate(_POSE):
        stem, _, unit_name = name.partition("_")
        columns |= {f"{stem}_{side}_{unit_name}": ends[:, s, k] for s, side in enumerate(("min", "max"))}
    return pa.table(columns)
