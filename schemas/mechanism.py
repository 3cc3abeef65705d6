"""[mechanism]: legs with actuators that carry a platform, or none; what is common to all types."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from truing.schemas.elastic import Modulus, Poisson, thin_rod
from truing.schemas.section import TYPED, Finite, Name, NotNegative, Path, Positive, Section, Share, Temperature, Vector

# A lab's package names its own closures of a leg under this group: `"my-type" = "my_package.legs:MyLeg"`.
CLOSURES = "truing.closures"
OF_LEGS = ("6-pus", "ups")
WITHOUT_LEGS = ("6-upur", "axis", "none")
"""Types whose bodies no legs with actuators carry."""


class Leg(Section):
    """One leg of a legged mechanism: joints, actuator direction and lengths."""

    a_mm: Vector = Field(description="actuator's zero on the base, base frame")
    b_mm: Vector = Field(description="joint on the platform, platform frame")
    u: Vector | None = Field(None, description="unit direction of the actuator, base frame")
    length_mm: Positive = Field(description="leg length (ups: at zero reading)")
    rho0_mm: Finite = Field(0.0, description="actuator reading in the reference configuration")
    flexure_length_mm: Positive | None = Field(None, description="length of the flexures at its ends")

    @model_validator(mode="after")
    def _direction_is_unit(self) -> Leg:
        if self.u is not None and abs(sum(c * c for c in self.u) - 1.0) > TYPED:
            raise ValueError("u must have unit length")
        return self


class Rod(Section):
    """A circular elastic part: flexure or leg tube."""

    diameter_mm: Positive = Field(description="its diameter")
    youngs_gpa: Modulus = Field(description="Young's modulus")
    poisson: Poisson = Field(description="Poisson's ratio")


class Tolerance(Section):
    """[mechanism.tolerance]: one standard deviation of manufacturing and assembly, the prior of calibration."""

    a_mm: NotNegative | None = Field(None, description="each coordinate of the joints on the base")
    b_mm: NotNegative | None = Field(None, description="each coordinate of the joints on the platform")
    u: Share | None = Field(None, description="direction of the actuators, rad")
    length_mm: NotNegative | None = Field(None, description="leg length")
    rho0_mm: NotNegative | None = Field(None, description="reference reading of the actuators")


class MechanismSection(Section):
    """[mechanism], whatever its type."""

    type: Name = Field(description="6-pus, ups, 6-upur, axis, none, or what an installed package adds")
    reference_temperature_c: Temperature = Field(20.0, description="of the survey and of the nominal geometry")

    @property
    def is_legged(self) -> bool:
        """Whether legs with actuators carry a platform, whose readings say where it is."""
        return self.type not in WITHOUT_LEGS


def _known_closure(kind: str) -> str:
    """Own types first: asking what is installed takes time."""
    if kind not in OF_LEGS:
        added = sorted(entry_points(group=CLOSURES).names)
        if kind not in added:
            raise ValueError(f"one of {', '.join((*OF_LEGS, *WITHOUT_LEGS, *added))}")
    return kind


class NoMechanism(MechanismSection):
    """[mechanism] absent or type = "none": bodies of any names, and nothing that says how they move."""

    type: Literal["none"] = Field("none", description="none: bodies of any names")


class LeggedMechanism(MechanismSection):
    """[mechanism] of type 6-pus, ups or an installed package's own: nominal geometry and its tolerance."""

    type: Annotated[str, AfterValidator(_known_closure)] = Field(
        description="6-pus: fixed legs, moved actuators; ups: legs of variable length; or an installed package's own"
    )
    legs: tuple[Leg, ...] = Field(description="one entry per leg, in leg order")
    flexure: Rod | None = Field(None, description="stiffness model: the flexures")
    leg_tube: Rod | None = Field(None, description="stiffness model: the legs")
    tolerance: Tolerance = Field(Tolerance(), description="how well the geometry is known beforehand")
    actuator_pitch_mm: Positive | None = Field(None, description="pitch of the actuators' leadscrew")
    model: Path | None = Field(None, description="model.toml of an earlier campaign of this machine, to start from")

    @model_validator(mode="after")
    def _legs_fit_the_type(self) -> LeggedMechanism:
        if self.type == "6-pus" and len(self.legs) != 6:
            raise ValueError(f"six legs for a 6-pus, not {len(self.legs)}")
        if self.type == "6-pus" and any(leg.u is None for leg in self.legs):
            raise ValueError("the actuator direction u for every leg of a 6-pus")
        if len(self.legs) < 3:
            raise ValueError(f"at least three legs for a {self.type}, not {len(self.legs)}")
        return self

    @model_validator(mode="after")
    def _parts_are_no_longer_than_the_legs(self) -> LeggedMechanism:
        """A tolerance or flexure longer than a leg contradicts the drawing: a slipped decimal, or another unit."""
        shortest = min(leg.length_mm for leg in self.legs)
        sizes = {f"tolerance.{name}": size or 0.0 for name, size in self.tolerance if name.endswith("_mm")}
        sizes["two flexures of a leg"] = max(2.0 * (leg.flexure_length_mm or 0.0) for leg in self.legs)
        large = [f"{name} ({size:g})" for name, size in sizes.items() if size > shortest]
        if self.flexure is not None:
            thin_rod("flexure", self.flexure.diameter_mm, max(leg.flexure_length_mm or 0.0 for leg in self.legs))
        if self.leg_tube is not None:
            thin_rod("leg_tube", self.leg_tube.diameter_mm, shortest)
        if large:
            raise ValueError(f"no more than the shortest leg, {shortest:g} mm: {', '.join(large)}")
        return self
