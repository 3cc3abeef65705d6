"""[interferometer] of campaign.toml: light and air, and what is known of beams, of the frame and of the instruments
beside it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from truing.schemas.section import Finite, NotNegative, Positive, Section, Vector

LINEAR = ("dx", "dy", "dz")
_AXES = (*LINEAR, "rx", "ry", "rz")
# A beam 45 degrees off its channel's axis reads another channel as much; up to 30, three beams always tell three axes.
_NEAREST_SQUARED = 0.75  # cos(30 degrees) squared
# No solid grows faster; 11.5 for 11.5e-6 is what it keeps out.
_LARGEST_EXPANSION = 1e-3

Expansion = Annotated[float, Field(gt=0.0, lt=_LARGEST_EXPANSION, allow_inf_nan=False)]


class DeadPaths(Section):
    """[interferometer.dead_path_mm]: of linear channels; an angle is the difference of two beams: theirs cancel.

    Negative where a reading counts positive as its path gets shorter.
    """

    dx: Finite = Field(0.0, description="of the channel dx")
    dy: Finite = Field(0.0, description="of the channel dy")
    dz: Finite = Field(0.0, description="of the channel dz")


class RotationAxis(Section):
    """What an angular channel turns about."""

    direction: Vector | None = Field(None, description="fixed frame, of any length; absent: the channel's own axis")
    direction_sigma_rad: NotNegative = Field(0.0, description="one sigma of its angles across")


class Beam(RotationAxis):
    """How a linear channel's beam meets the platform: along a direction, at an arm from its origin."""

    arm_mm: Vector = Field((0.0, 0.0, 0.0), description="from the platform's origin to the point that the beam meets")
    arm_sigma_mm: NotNegative = Field(0.0, description="one sigma of the arm, in each direction")


class Beams(Section):
    """[interferometer.beams]: cosine and Abbe terms of each channel, where the geometry is known."""

    dx: Beam = Field(Beam(), description="the beam of dx")
    dy: Beam = Field(Beam(), description="the beam of dy")
    dz: Beam = Field(Beam(), description="the beam of dz")
    rx: RotationAxis = Field(RotationAxis(), description="the axis of rx")
    ry: RotationAxis = Field(RotationAxis(), description="the axis of ry")
    rz: RotationAxis = Field(RotationAxis(), description="the axis of rz")

    @field_validator(*_AXES)
    @classmethod
    def _along_its_channel(cls, given: RotationAxis, info: ValidationInfo) -> RotationAxis:
        if given.direction is None:
            return given
        own = given.direction[_AXES.index(str(info.field_name)) % 3]
        if own <= 0.0 or own**2 < _NEAREST_SQUARED * sum(part**2 for part in given.direction):
            raise ValueError("a direction within 30 degrees of the channel's own axis, the way in which it counts up")
        return given

    @property
    def are_plain(self) -> bool:
        """Whether every channel is along its own axis through the platform's origin, as far as anybody knows."""
        return self == Beams()


class Growth(Section):
    """Material between a channel's mirror and what is measured, and how it grows."""

    length_mm: Finite = Field(
        description="positive where growth moves the mirror the way in which the channel counts up"
    )
    expansion_per_k: Expansion = Field(description="expansion of the material")
    expansion_sigma_per_k: NotNegative = Field(0.0, description="one sigma of it")


class AxisGrowth(Section):
    """A positioned axis: it is as long as its material's temperature makes it."""

    expansion_per_k: Expansion = Field(description="expansion of the material")
    expansion_sigma_per_k: NotNegative = Field(0.0, description="one sigma of it")


class Material(Section):
    """[interferometer.material]: what material_temperature_c does to readings; corrected where it is said."""

    dx: Growth | None = Field(None, description="of the channel dx")
    dy: Growth | None = Field(None, description="of the channel dy")
    dz: Growth | None = Field(None, description="of the channel dz")
    axis: AxisGrowth | None = Field(None, description="positioning runs")


class SurroundingsSigma(Section):
    """[interferometer.surroundings_sigma]: one sigma of what reads air and material, and of the index."""

    air_temperature_c: NotNegative = Field(0.0, description="temperature of the air")
    air_pressure_hpa: NotNegative = Field(0.0, description="its pressure")
    relative_humidity_pct: NotNegative = Field(0.0, description="its humidity")
    material_temperature_c: NotNegative = Field(0.0, description="temperature of the material")
    index: NotNegative = Field(1e-8, description="of the equation of the refractive index")


class Interferometer(Section):
    """[interferometer]: wavelength, dead path, air, beams and material."""

    wavelength_nm: float = Field(632.990577, gt=100.0, lt=1e5, description="of the laser in vacuum")
    dead_path_mm: DeadPaths = Field(
        DeadPaths(),
        description="one number, or one per linear channel; negative where a reading grows as its path shrinks",
    )
    compensated: bool = Field(True, description="whether readings are compensated for the refractive index of air")
    passes: int = Field(2, ge=1, description="raw signals: how often light goes the way to the mirror")
    average_samples: bool = Field(
        False, description="readings: several of a step and channel are samples of it, and their mean counts"
    )
    signal_step: Positive | None = Field(None, description="raw signals: whole steps of a converter, this large")
    beams: Beams = Field(Beams(), description="where a beam is askew, or meets the platform off its origin")
    material: Material = Field(Material(), description="what the material between mirror and platform grows")
    surroundings_sigma: SurroundingsSigma | None = Field(
        None, description="how well air and material are known; absent: exactly"
    )

    @field_validator("dead_path_mm", mode="before")
    @classmethod
    def _one_for_all(cls, given: Any) -> Any:
        if isinstance(given, int | float) and not isinstance(given, bool):
            return dict.fromkeys(LINEAR, given)
        if not isinstance(given, dict | DeadPaths):
            raise ValueError("one number, or one per linear channel: { dx = .., dy = .., dz = .. }")
        return given
