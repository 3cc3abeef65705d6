"""[mechanism] of type chain: an open chain of joints by URDF, by rows of Denavit and Hartenberg, or by screws."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from truing.schemas.mechanism import MechanismSection
from truing.schemas.section import TYPED, Finite, Name, NotNegative, Path, Positive, Section, Vector

_PARENTS = ("urdf", "dh", "screws")


class HartenbergRow(Section):
    """One row of Denavit and Hartenberg, from one joint to the next."""

    a_mm: Finite = Field(0.0, description="distance of the joint axes along x")
    alpha_deg: Finite = Field(0.0, description="angle between the joint axes about x")
    d_mm: Finite = Field(0.0, description="distance along the joint's axis; prismatic: at reading zero")
    theta_deg: Finite = Field(0.0, description="angle about the joint's axis; revolute: at reading zero")
    kind: Literal["revolute", "prismatic"] = Field("revolute", description="motion of the joint")
    convention: Literal["standard", "modified"] = Field(
        "standard",
        description="standard: theta, d, a, alpha; modified (Craig): alpha, a before theta, d",
    )
    mass_kg: NotNegative = Field(0.0, description="mass of the link that the joint moves; 0: unknown")
    com_mm: Vector | None = Field(
        None,
        description="its centre of mass, in the frame of the joint: on its axis, before d, a and alpha of a standard "
        "row (before d of a modified one); absent: unknown, and fitted",
    )


class ScrewRow(Section):
    """One joint as a line in space, where all readings are zero."""

    axis: Vector = Field(description="direction of the joint's axis, base frame")
    point_mm: Vector = Field((0.0, 0.0, 0.0), description="a point on the axis, base frame")
    kind: Literal["revolute", "prismatic"] = Field("revolute", description="motion of the joint")
    mass_kg: NotNegative = Field(0.0, description="mass of the link that the joint moves; 0: unknown")
    com_mm: Vector | None = Field(
        None, description="its centre of mass, from that point, base axes; absent: unknown, and fitted"
    )

    @model_validator(mode="after")
    def _axis_is_a_direction(self) -> ScrewRow:
        if not sum(c * c for c in self.axis) > TYPED:
            raise ValueError("an axis: three numbers, not all zero")
        return self


class HomePose(Section):
    """Pose of the tip in the base frame where all readings are zero."""

    position_mm: Vector = Field((0.0, 0.0, 0.0), description="origin of the tip")
    rotation_rad: Vector = Field((0.0, 0.0, 0.0), description="rotation vector of the tip")


class ChainTolerance(Section):
    """[mechanism.tolerance] of a chain: one standard deviation of manufacturing and assembly.

    A link number without a tolerance is free. A joint's zero without one counts as exact, so that `joint-offset`
    can be found.
    """

    offset_deg: NotNegative | None = Field(None, description="zero of a revolute joint; absent: exact")
    offset_mm: NotNegative | None = Field(
        None, description="zero of a prismatic joint; absent: as length_mm, else exact"
    )
    length_mm: NotNegative | None = Field(None, description="each shift of a joint's frame in its link; absent: free")
    angle_deg: NotNegative | None = Field(None, description="each rotation of a joint's frame; absent: free")


class ChainMechanism(MechanismSection):
    """[mechanism] of type chain: joints and links, their readings, and their tolerance."""

    type: Literal["chain"] = Field(description="a chain: serial arm, gantry, arm on a rail; with closure also loops")
    urdf: Path | None = Field(None, description="robot description, in m and rad")
    dh: tuple[HartenbergRow, ...] = Field((), description="rows of Denavit and Hartenberg, instead of urdf")
    screws: tuple[ScrewRow, ...] = Field((), description="joint axes in the base frame, instead of urdf")
    home: HomePose = Field(HomePose(), description="screws: pose of the tip where all readings are zero")
    base: Name | None = Field(None, description="link of the fixed frame; absent: the URDF's first link, or base")
    tip: Name | None = Field(None, description="last link; absent: the URDF's only last link, or tip")
    joints: tuple[Name, ...] = Field(
        (), description="joints that are read, in order; absent: all that move, between base and tip"
    )
    closure: Name | None = Field(
        None, description="closure of an installed package for loops of links; joints that it moves are not read"
    )
    gravity: Vector | None = Field(
        None, description="direction of gravity, base frame; absent: effects of weight are not tested"
    )
    payload_kg: NotNegative = Field(
        0.0, description="mass at the tip; a column payload_kg of configurations.csv has precedence"
    )
    payload_com_mm: Vector | None = Field(
        None, description="centre of this mass, frame of the tip; absent: unknown, and fitted"
    )
    gear_orders: dict[Name, tuple[Positive, ...]] = Field(
        {},
        description="periods per turn of errors by gears, by joint; for other joints orders up to 200 are searched",
    )
    pitch_mm: dict[Name, tuple[Positive, ...]] = Field(
        {},
        description="periods of errors by screws, racks or scales, by slide; of other slides periods up to 200 times "
        "in the travel are searched",
    )
    tolerance: ChainTolerance = Field(ChainTolerance(), description="prior uncertainty of geometry and joint zeros")

    @model_validator(mode="after")
    def _one_description(self) -> ChainMechanism:
        descriptions = [name for name in _PARENTS if getattr(self, name)]
        if len(descriptions) != 1:
            raise ValueError(f"one of urdf, dh, screws, not {' and '.join(descriptions) or 'none'}")
        rows = len(self.dh) or len(self.screws)
        if rows and self.joints and len(self.joints) != rows:
            raise ValueError(f"a joint for each of {rows} rows, not {len(self.joints)}")
        if len(set(self.joints)) < len(self.joints):
            raise ValueError("different names in joints")
        if self.closure is not None and self.urdf is None:
            raise ValueError("urdf next to closure: rows describe no branches that a loop could close")
        if self.closure is not None and not self.joints:
            raise ValueError("the joints that are read next to closure: it moves all others")
        if self.gravity is not None and not any(self.gravity):
            raise ValueError("a direction as gravity: three numbers, not all zero")
        return self

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints by rows; those of a URDF may follow from the file."""
        rows = len(self.dh) or len(self.screws)
        return self.joints or tuple(f"joint{k}" for k in range(1, rows + 1))
