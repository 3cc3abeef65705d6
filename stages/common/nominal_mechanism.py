"""The mechanism of campaign.toml, in m."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.estimation.rotation import exp_so3
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.mechanisms.legs.closures import Legs, mechanism
from truing.simulation.mechanisms.legs.kinematics import unit
from truing.simulation.mechanisms.structures.beams import section
from truing.simulation.mechanisms.structures.structure import BeamSection, Machine
from truing.stages.common.missing_data import NO_CHOICE
from truing.stages.common.point_arrays import pose_vectors

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism
    from truing.schemas.mechanism import Rod as RodSection

FILE = "campaign.toml"


def nominal_legs(section: LeggedMechanism) -> Legs:
    """Legs of campaign.toml, in m."""
    legs = section.legs
    directions = [unit(np.array(leg.u)) for leg in legs if leg.u is not None]
    return mechanism(
        section.type,
        np.array([leg.a_mm for leg in legs]) * 1e-3,
        np.array([leg.b_mm for leg in legs]) * 1e-3,
        directions if len(directions) == len(legs) else None,
        np.array([leg.length_mm for leg in legs]) * 1e-3,
        np.array([leg.rho0_mm for leg in legs]) * 1e-3,
    )


def facing(legs: Legs, poses: pa.Table) -> Legs:
    """Return legs without actuator directions, assembled on the side of the measured platform.

    Lengths alone leave two sides; the direction u, which such a closure does not use, selects the start of the search.
    """
    if "u" in legs.closure.geometry:
        return legs
    is_platform = pc.and_(pc.equal(poses.column("body"), "platform"), pc.equal(poses.column("parent"), "base"))
    rows = poses.filter(pc.and_(poses.column("default"), is_platform))
    vectors = pose_vectors(rows)
    p, R = vectors[:, :3], exp_so3(np.nan_to_num(vectors[:, 3:]))
    away = (p + R @ legs.b.mean(0) - legs.a.mean(0))[np.isfinite(p).all(1)]
    return legs.replace(u=np.broadcast_to(unit(away.mean(0)), legs.a.shape)) if len(away) else legs


def nominal_machine(mechanism: LeggedMechanism) -> Machine:
    """Machine of campaign.toml, without deformation."""
    lengths = [leg.flexure_length_mm for leg in mechanism.legs]
    known = all(length is not None for length in lengths)
    return Machine(
        nominal_legs(mechanism),
        np.zeros((len(lengths), len(lengths))),
        np.array(lengths, float) * 1e-3 if known else None,
        _section(mechanism.flexure),
        _section(mechanism.leg_tube),
        beta=np.array([leg.flexure_beta for leg in mechanism.legs]),
        follows_motion=mechanism.stiffness_along_motion,
    )


def _section(rod: RodSection | None) -> BeamSection | None:
    return None if rod is None else section(rod.diameter_mm * 1e-3, rod.youngs_gpa * 1e9, rod.poisson)


def plain_machine(settings: Campaign) -> Machine:
    """Return the nominal mechanism with rigid platform; raises CampaignFaults for fewer than six legs."""
    section = settings.mechanism
    if not section.is_legged:
        expected = "a mechanism whose configurations can be chosen: legs and actuators, photogrammetry"
        expected += NO_CHOICE.get(section.type, "")
        raise CampaignFaults([Fault(FILE, expected, column="mechanism.type", value=section.type)])
    legs = nominal_legs(cast("LeggedMechanism", section))
    if legs.count < 6:
        expected = "six legs or more, because fewer do not constrain the pose of the platform"
        raise CampaignFaults([Fault(FILE, expected, column="mechanism.legs", value=str(legs.count))])
    return Machine(legs, np.zeros((legs.count, legs.count)))
