"""[interferometer]: wavelength, air, beam geometry, material and their uncertainties."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator

from truing.schemas.section import Finite, NotNegative, Positive, Section, Vector

LINEAR = ("dx", "dy", "dz")
_AXES = (*LINEAR, "rx", "ry", "rz")
# At 45 degrees a beam reads two channels equally; up to 30, three beams always determine three axes.
_NEAREST_SQUARED = 0.75  # cos(30 degrees) squared
# Above any solid's; rejects 11.5 given for 11.5e-6.
_LARGEST_EXPANSION = 1e-3

Expansion = Annotated[float, Field(gt=0.0, lt=_LARGEST_EXPANSION, allow_inf_nan=False)]


class DeadPaths(Section):
    """[interferometer.dead_path_mm]: dead paths of linear channels, negative if a reading grows as its path shrinks.
    The dead paths of the two beams of an angular channel cancel."""

    dx: Finite = Field(0.0, description="channel dx")
    dy: Finite = Field(0.0, description="channel dy")
    dz: Finite = Field(0.0, description="channel dz")


class RotationAxis(Section):
    """Rotation axis of an angular channel."""

    direction: Vector | None = Field(
        None, description="in the fixed frame, of any length; absent: the channel's own axis"
    )
    direction_sigma_rad: NotNegative = Field(0.0, description="standard deviation of its transverse angles")


class Beam(RotationAxis):
    """Beam of a linear channel: direction, and arm from the platform's origin to the point that it measures."""

    arm_mm: Vector = Field(
        (0.0, 0.0, 0.0), description="from the platform's origin to the point that the beam measures"
    )
    arm_sigma_mm: NotNegative = Field(0.0, description="standard deviation of each component of the arm")


class Beams(Section):
    """[interferometer.beams]: geometry of the beams, for cosine and Abbe corrections."""

    dx: Beam = Field(Beam(), description="beam of dx")
    dy: Beam = Field(Beam(), description="beam of dy")
    dz: Beam = Field(Beam(), description="beam of dz")
    rx: RotationAxis = Field(RotationAxis(), description="axis of rx")
    ry: RotationAxis = Field(RotationAxis(), description="axis of ry")
    rz: RotationAxis = Field(RotationAxis(), description="axis of rz")

    @field_validator(*_AXES)
    @classmethod
    def _along_its_channel(cls, rotation_axis: RotationAxis, info: ValidationInfo) -> RotationAxis:
        if rotation_axis.direction is None:
            return rotation_axis
        component = rotation_axis.direction[_AXES.index(str(info.field_name)) % 3]
        if component <= 0.0 or component**2 < _NEAREST_SQUARED * sum(part**2 for part in rotation_axis.direction):
            raise ValueError("a direction within 30 degrees of the channel's own axis, pointing to increasing readings")
        return rotation_axis

    @property
    def are_plain(self) -> bool:
        """True if every channel is declared as along its own axis through the platform's origin."""
        return self == Beams()


class Growth(Section):
    """Material between a channel's mirror and the measured point, and its expansion."""

    length_mm: Finite = Field(description="positive if expansion increases the reading")
    expansion_per_k: Expansion = Field(description="expansion of the material")
    expansion_sigma_per_k: NotNegative = Field(0.0, description="standard deviation of the expansion")


class MaterialGrowth(Section):
    """Thermal expansion of a positioned axis."""

    expansion_per_k: Expansion = Field(description="expansion of the material")
    expansion_sigma_per_k: NotNegative = Field(0.0, description="standard deviation of the expansion")


class Material(Section):
    """[interferometer.material]: effect of material_temperature_c on readings; declared channels are corrected."""

    dx: Growth | None = Field(None, description="channel dx")
    dy: Growth | None = Field(None, description="channel dy")
    dz: Growth | None = Field(None, description="channel dz")
    axis: MaterialGrowth | None = Field(None, description="positioning runs")


class SurroundingsSigma(Section):
    """[interferometer.surroundings_sigma]: standard deviations of the sensors of air and material, and of the
    refractive index."""

    air_temperature_c: NotNegative = Field(0.0, description="temperature of the air")
    air_pressure_hpa: NotNegative = Field(0.0, description="pressure of the air")
    relative_humidity_pct: NotNegative = Field(0.0, description="humidity of the air")
    material_temperature_c: NotNegative = Field(0.0, description="temperature of the material")
    index: NotNegative = Field(1e-8, description="equation of the refractive index")


class Interferometer(Section):
    """[interferometer]: wavelength, dead path, air, beams and material."""

    wavelength_nm: float = Field(632.990577, gt=100.0, lt=1e5, description="vacuum wavelength of the laser")
    dead_path_mm: DeadPaths = Field(
        DeadPaths(),
        description="one number, or one per linear channel; negative where a reading grows as its path shrinks",
    )
    compensated: bool = Field(True, description="whether readings are compensated for the refractive index of air")
    passes: int = Field(2, ge=1, description="raw signals: number of passes of the light to the mirror")
    average_samples: bool = Field(
        False, description="readings: several of one step and channel are samples, and their mean is used"
    )
    signal_step: Positive | None = Field(
        None, description="raw signals: step of the converter, if they are whole multiples of it"
    )
    beams: Beams = Field(Beams(), description="for beams that are oblique, or that miss the platform's origin")
    material: Material = Field(Material(), description="expansion of the material between mirror and platform")
    surroundings_sigma: SurroundingsSigma | None = Field(
        None, description="uncertainty of air and material; absent: exact"
    )

    @field_validator("dead_path_mm", mode="before")
    @classmethod
    def _same_for_all(cls, value: object) -> object:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return dict.fromkeys(LINEAR, value)
        if not isinstance(value, dict | DeadPaths):
            raise ValueError("one number, or one per linear channel: { dx = .., dy = .., dz = .. }")
        return value
