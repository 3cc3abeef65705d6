"""From a run's tables to what a calibration compares: poses and readings with their covariances, and what is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from stages.calibration.network import NetworkErrors, network_errors
from stages.common.point_arrays import number_column, pose_ids, positions, survey_points
from stages.diagnosis.mechanism_points import facing, nominal_legs
from truing.estimation.rotation import exp_so3
from truing.simulation.beam_element import section
from truing.simulation.structure import Machine, Section

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign
    from schemas.mechanism import LeggedMechanism
    from schemas.mechanism import Rod as RodSection

LEAST_FRAME = 3  # targets away from the attachments that make a frame of the platform


@dataclass(frozen=True)
class BodyPoses:
    """Poses of a body in its parent: p (B, 3) m, R (B, 3, 3), covariance (B, 6, 6) of (p, theta) with
    R <- exp(theta) R; NaN where the body was not found."""

    p: NDArray
    R: NDArray
    covariance: NDArray

    def chosen(self, rows: NDArray) -> BodyPoses:
        """Return some of the poses."""
        return BodyPoses(self.p[rows], self.R[rows], self.covariance[rows])

    @property
    def found(self) -> NDArray:
        """Return where (B,) the body was found."""
        return np.isfinite(self.p).all(-1) & np.isfinite(self.covariance).all((-1, -2))


@dataclass(frozen=True)
class Shifts:
    """Shifts (B, L), m, of the attachments along z of the platform off their survey, and sigma (B, L) of what their own
    targets bring to it; NaN where none was seen, or a gross error was."""

    shift: NDArray
    sigma: NDArray

    def chosen(self, rows: NDArray) -> Shifts:
        """Return those of some poses."""
        return Shifts(self.shift[rows], self.sigma[rows])


@dataclass(frozen=True)
class Measured:
    """Measured poses of the platform with the actuators' readings, rho (B, L) m, and the poses of legs with targets.

    Platform and legs are seen from the base, the base from the measurement: its error is common to all of them. Where
    their points come out of photographs, ``network`` says what they have in common, and that takes its place.
    """

    poses: tuple[int | str, ...]
    roles: NDArray  # (B,) of text
    base: BodyPoses
    platform: BodyPoses
    rho: NDArray
    legs: Mapping[int, BodyPoses]  # by leg, counted from 0
    shifts: Shifts | None = None
    network: NetworkErrors | None = None

    def chosen(self, rows: NDArray) -> Measured:
        """Return some of the poses, by mask (B,)."""
        return Measured(
            tuple(pose for pose, kept in zip(self.poses, rows, strict=True) if kept),
            self.roles[rows],
            self.base.chosen(rows),
            self.platform.chosen(rows),
            self.rho[rows],
            {leg: poses.chosen(rows) for leg, poses in self.legs.items()},
            self.shifts and self.shifts.chosen(rows),
            self.network and self.network.chosen(rows),
        )


@dataclass(frozen=True)
class Deformation:
    """What the targets on the attachments say of a deformation: K (L, L) m/m, sigma (L, L), NaN where open."""

    K: NDArray
    sigma: NDArray


@dataclass(frozen=True)
class SurveyedAttachments:
    """Places b (A, 3), m, of the attachments of legs (A,), counted from 0, as surveyed; covariance (3A, 3A)."""

    legs: NDArray
    b: NDArray
    covariance: NDArray


@dataclass(frozen=True)
class Gathered:
    """Measured poses that can be used, the nominal machine, what is known beforehand, and what was left out."""

    measured: Measured
    machine: Machine
    tolerance: Mapping[str, float]  # one sigma of a, b, l, rho0 (m) and u (1), where campaign.toml gives it
    reading_sigma: float  # m
    deformations: Mapping[str, Deformation]  # linear, matrix, where the deformation stage determined them
    surveyed: SurveyedAttachments | None
    left_out: str
    modulo_plane: bool = False  # too few platform targets away from the attachments: its frame deforms with them


def gather(tables: Mapping[str, pa.Table], settings: Campaign) -> Gathered:
    """Return what a calibration compares; raises ValueError, saying why, where the campaign does not hold it."""
    section_ = cast("LeggedMechanism", settings.mechanism)
    count = len(section_.legs)
    poses = pose_ids(tables["configurations"])
    base = body_poses(tables["poses"], "base", poses, parent="measurement")
    platform = body_poses(tables["poses"], "platform", poses)
    rho = _readings(tables["configurations"], poses, count)
    usable = platform.found & np.isfinite(rho).all(1)
    legs = {leg: body_poses(tables["poses"], f"leg{leg + 1}", poses) for leg in range(count)}
    carrying = {leg: found for leg, found in legs.items() if found.found.any()}
    machine = nominal_machine(section_)
    surveyed = _surveyed_attachments(tables, settings)
    shifts = None if surveyed is None else _shifts(tables.get("deformation"), poses, count)
    roles = _roles(tables["configurations"], poses)
    seen = {"platform": platform} | {f"leg{leg + 1}": found for leg, found in carrying.items()}
    network = network_errors(tables, poses, {name: found.covariance for name, found in seen.items()}, count)
    measured = Measured(poses, roles, base, platform, rho, carrying, shifts, network).chosen(usable)
    if not usable.any():
        raise ValueError("no pose has both readings and a pose of the platform in the base")
    return Gathered(
        measured,
        replace(machine, legs=facing(machine.legs, tables["poses"])),
        _tolerances(section_),
        settings.noise.actuator_mm * 1e-3,
        _deformations(tables.get("deformation_models"), count),
        surveyed,
        "" if usable.all() else f"{int((~usable).sum())} poses without readings or without a pose of the platform",
        "survey" in tables and _frame_of_attachments(tables["survey"]),
    )


def _frame_of_attachments(survey: pa.Table) -> bool:
    """Whether the platform's frame rests on the attachments themselves, so that it cannot tell how they move."""
    platform = survey_points(survey, "platform")
    return bool((platform.leg > 0).any() and np.sum(platform.leg == 0) < LEAST_FRAME)


def nominal_machine(mechanism: LeggedMechanism) -> Machine:
    """The machine that campaign.toml describes, before any deformation."""
    lengths = [leg.flexure_length_mm for leg in mechanism.legs]
    known = all(length is not None for length in lengths)
    return Machine(
        nominal_legs(mechanism),
        np.zeros((len(lengths), len(lengths))),
        np.array(lengths, float) * 1e-3 if known else None,
        _section(mechanism.flexure),
        _section(mechanism.leg_tube),
    )


def _section(rod: RodSection | None) -> Section | None:
    return None if rod is None else section(rod.diameter_mm * 1e-3, rod.youngs_gpa * 1e9, rod.poisson)


def body_poses(table: pa.Table, body: str, poses: tuple[int | str, ...], parent: str = "base") -> BodyPoses:
    """The default poses of a body in its parent, in the given order; NaN where there is none or its fit failed."""
    import pyarrow.compute as pc

    own = pc.and_(pc.equal(table.column("body"), body), pc.equal(table.column("parent"), parent))
    good = pc.and_(table.column("default"), pc.equal(table.column("status"), "ok"))
    rows = table.filter(pc.and_(own, good))
    place = positions(rows.column("pose"), poses)
    p, vector = np.full((len(poses), 3), np.nan), np.zeros((len(poses), 3))
    covariance = np.full((len(poses), 6, 6), np.nan)
    kept = place >= 0
    p[place[kept]] = np.column_stack([number_column(rows, f"p{a}_mm") for a in "xyz"])[kept] * 1e-3
    vector[place[kept]] = np.column_stack([number_column(rows, f"r{a}_rad") for a in "xyz"])[kept]
    for i in range(6):
        for j in range(i, 6):
            covariance[place[kept], i, j] = covariance[place[kept], j, i] = number_column(rows, f"cov_{i}_{j}")[kept]
    return BodyPoses(p, exp_so3(np.nan_to_num(vector)), covariance)


def _readings(configurations: pa.Table, poses: tuple[int | str, ...], legs: int) -> NDArray:
    readings = np.full((len(poses), legs), np.nan)
    columns = [number_column(configurations, f"rho{leg}_mm") for leg in range(1, legs + 1)]
    readings[positions(configurations.column("pose"), poses)] = np.column_stack(columns) * 1e-3
    return readings


def _shifts(table: pa.Table | None, poses: tuple[int | str, ...], legs: int) -> Shifts | None:
    if table is None or not table.num_rows or "own_sigma_um" not in table.schema.names:
        return None
    import pyarrow.compute as pc

    rows = table.filter(pc.invert(table.column("rejected")))
    place = positions(rows.column("pose"), poses), number_column(rows, "leg").astype(int) - 1
    kept = place[0] >= 0
    found = Shifts(np.full((len(poses), legs), np.nan), np.full((len(poses), legs), np.nan))
    for target, name in ((found.shift, "delta_bz_um"), (found.sigma, "own_sigma_um")):
        target[place[0][kept], place[1][kept]] = number_column(rows, name)[kept] * 1e-6
    return found


def _roles(configurations: pa.Table, poses: tuple[int | str, ...]) -> NDArray:
    roles = np.full(len(poses), "", object)
    roles[positions(configurations.column("pose"), poses)] = configurations.column("role").to_pylist()
    return roles


def _tolerances(mechanism: LeggedMechanism) -> dict[str, float]:
    given = mechanism.tolerance
    sigmas = {"a": given.a_mm, "b": given.b_mm, "l": given.length_mm, "rho0": given.rho0_mm}
    found = {name: sigma * 1e-3 for name, sigma in sigmas.items() if sigma is not None}
    return found if given.u is None else {**found, "u": given.u}


def _deformations(models: pa.Table | None, legs: int) -> dict[str, Deformation]:
    if models is None:
        return {}
    rows = [row for row in models.to_pylist() if row["leg"] is not None and row["column"] > 0]
    found = {name: _coefficients([row for row in rows if row["model"] == name], legs) for name in ("linear", "matrix")}
    return {name: one for name, one in found.items() if np.isfinite(one.K).any()}


def _coefficients(rows: list[dict[str, Any]], legs: int) -> Deformation:
    K, sigma = np.full((legs, legs), np.nan), np.full((legs, legs), np.nan)
    for row in rows:
        K[row["leg"] - 1, row["column"] - 1] = row["coefficient"]
        sigma[row["leg"] - 1, row["column"] - 1] = row["sigma"]
    return Deformation(K, sigma)


def _surveyed_attachments(tables: Mapping[str, pa.Table], settings: Campaign) -> SurveyedAttachments | None:
    """Where the survey says that the attachments are; None where it cannot say so in the frame of the platform."""
    from truing.simulation.survey import shape_unknowns
    from truing.simulation.targets import PLATFORM, Targets

    if "survey" not in tables or settings.noise.point_mm is None:
        return None
    platform = survey_points(tables["survey"], "platform")
    seats = platform.leg > 0
    if not seats.any() or np.sum(~seats) < LEAST_FRAME:
        return None
    noise = np.eye(3) * (settings.noise.point_mm * 1e-3) ** 2
    known = np.isfinite(platform.cov).all((1, 2)) & (np.trace(platform.cov, axis1=1, axis2=2) > 0)
    covariance = np.where(known[:, None, None], platform.cov, noise)
    targets = Targets(np.full(len(seats), PLATFORM), platform.leg - 1)
    factor = shape_unknowns(targets, platform.points, covariance).attachment_factor
    return SurveyedAttachments(platform.leg[seats] - 1, platform.points[seats], factor @ factor.T)
