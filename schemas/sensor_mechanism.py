"""[mechanism] of type 6-upur: a sensor's joint centres, and the elements of its legs or its compliance."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from truing.schemas.elastic import Modulus, Poisson, thin_rod
from truing.schemas.mechanism import MechanismSection
from truing.schemas.section import TYPED, Finite, NotNegative, Path, Positive, Section, Share, Vector


class SensorLeg(Section):
    """One leg of a 6-upur: its joint centres."""

    B_mm: Vector = Field(description="lower joint centre, fixed frame")
    b_mm: Vector = Field(description="upper joint centre, platform frame")


# What each kind of element needs; a rigid one without length takes up the rest of its leg, a notch is 2 radius long.
_ELASTIC = ("youngs_gpa", "poisson")
_NEEDED: dict[str, tuple[str, ...]] = {
    "cylinder": ("length_mm", "diameter_mm", *_ELASTIC),
    "leaf": ("length_mm", "width_mm", "thickness_mm", "soft", *_ELASTIC),
    "notch": ("width_mm", "web_mm", "radius_mm", "soft", *_ELASTIC),
    "spring": (),
    "rigid": (),
    "compliance": ("matrix",),
}
_ALLOWED: dict[str, tuple[str, ...]] = {
    "notch": ("length_mm", *_NEEDED["notch"]),
    "spring": ("length_mm", "axial_n_per_m", "torsion_n_m_per_rad"),
    "rigid": ("length_mm",),
    "compliance": ("length_mm", "matrix"),
}


class Element(Section):
    """One element of a sensor's leg, from the base to the platform; what it needs depends on its kind."""

    kind: Literal["cylinder", "leaf", "notch", "spring", "rigid", "compliance"] = Field(description="what it is")
    length_mm: NotNegative | None = Field(None, description="along the leg; absent: rigid takes up what is left of it")
    diameter_mm: Positive | None = Field(None, description="cylinder")
    width_mm: Positive | None = Field(None, description="leaf, notch: across")
    thickness_mm: Positive | None = Field(None, description="leaf")
    web_mm: Positive | None = Field(None, description="notch: what is left at its thinnest")
    radius_mm: Positive | None = Field(None, description="notch")
    soft: Literal["s1", "s2"] | None = Field(None, description="leaf, notch: the axis that it bends about")
    youngs_gpa: Modulus | None = Field(None, description="Young's modulus")
    poisson: Poisson | None = Field(None, description="Poisson's ratio")
    axial_n_per_m: Positive | None = Field(None, description="spring: stiffness along the leg; absent: rigid")
    torsion_n_m_per_rad: Positive | None = Field(None, description="spring: stiffness about the leg; absent: rigid")
    matrix: tuple[tuple[Finite, ...], ...] | None = Field(
        None, description="compliance, 6 x 6, SI, at the element's outer end"
    )

    @model_validator(mode="after")
    def _keys_fit_the_kind(self) -> Element:
        needed, kind = _NEEDED[self.kind], f"for kind {self.kind}"
        given = {name for name in self.model_fields_set if getattr(self, name) is not None} - {"kind"}
        if lacking := [name for name in needed if name not in given]:
            raise ValueError(f"{', '.join(lacking)} {kind}")
        if foreign := sorted(given - {*needed, *_ALLOWED.get(self.kind, ())}):
            allowed = ", ".join(_ALLOWED.get(self.kind, needed))
            raise ValueError(f"{allowed} {kind}, not {', '.join(foreign)}")
        if self.kind == "cylinder":
            thin_rod("cylinder", self.diameter_mm or 0.0, self.length_mm)
        own = 2.0 * (self.radius_mm or 0.0)
        if self.kind == "notch" and abs((self.length_mm or own) - own) > TYPED * own:
            raise ValueError(f"length_mm to be 2 radius_mm, {own:g}, {kind}; absent it is that")
        rows = [len(row) for row in self.matrix or ()]
        if rows and rows != [6] * 6:
            raise ValueError(f"a matrix of 6 x 6 numbers, not rows of {', '.join(map(str, rows))}")
        return self


class SensorTolerance(Section):
    """[mechanism.tolerance] of a 6-upur: full widths T, sigma = T / 6."""

    platform_radius_um: NotNegative | None = Field(None, description="radius of the upper joints")
    base_radius_um: NotNegative | None = Field(None, description="radius of the lower joints")
    lower_clearance_um: NotNegative | None = Field(None, description="clearance of the lower joint")
    middle_clearance_um: NotNegative | None = Field(None, description="clearance of the middle joint")
    sensor_installation_um: NotNegative | None = Field(None, description="installation of the cell in its leg")
    stiffness: Share = Field(0.0, description="one sigma, relative, of the elastic parameters")


class SensorMechanism(MechanismSection):
    """[mechanism] of type 6-upur: joint centres, and the elements of one leg or the compliance itself."""

    type: Literal["6-upur"] = Field(description="a force sensor of six elastic legs")
    legs: tuple[SensorLeg, ...] = Field(min_length=6, max_length=6, description="six entries, in leg order")
    height_mm: Positive = Field(description="platform's origin above that of the fixed frame, unloaded")
    elements: tuple[Element, ...] = Field((), description="of one leg, from the base to the platform")
    compliance_file: Path | None = Field(None, description="the simulated compliance, 6 x 6, SI, instead of elements")
    tolerance: SensorTolerance = Field(
        SensorTolerance(), description="how well geometry and stiffness are known beforehand"
    )
    model: Path | None = Field(None, description="model.toml of an earlier campaign of this sensor, to start from")

    @model_validator(mode="after")
    def _one_simulation(self) -> SensorMechanism:
        if self.elements and self.compliance_file is not None:
            raise ValueError("either elements or compliance_file, not both")
        return self
