"""[mechanism]: legs with actuators, a force sensor, one axis, or none; chains are in `chain_mechanism`."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from truing.schemas.installed import entry_points
from truing.schemas.near_names import did_you_mean
from truing.schemas.section import (
    TYPED,
    Finite,
    Name,
    NotNegative,
    OneOrSeveral,
    Path,
    Positive,
    Section,
    Share,
    Temperature,
    Vector,
)

_STIFFEST_GPA = 2000.0  # diamond has 1200
_IN_GPA = {"MPa": 1e-3, "Pa": 1e-9}
_LIKELY_GPA = (0.5, _STIFFEST_GPA)
# Least ratio of diameter to length of a rod; a diameter given in metres falls below it.
_THINNEST = 5e-4

# Entry points of closures in installed packages: `"my-type" = "my_package.legs:MyLeg"`.
CLOSURES = "truing.closures"
OF_LEGS = ("6-pus", "ups")
WITHOUT_LEGS = ("6-upur", "axis", "chain", "none")
"""Types without legs that have actuators."""

# Settings of stages that read the rows of an axis: columns, noise of the command, noise of the encoders.
COLUMNS_OF_AXES = tuple(f"mechanism.{name}" for name in ("kind", "command", "motor", "load", "loop")) + tuple(
    f"mechanism.{what}_{unit}" for what in ("counts_per", "period") for unit in ("deg", "mm")
)
NOISE_OF_COMMANDS = ("noise.command_deg", "noise.command_mm")
NOISE_OF_ENCODERS = tuple(f"noise.{name}_{unit}" for name in ("motor", "load", "measured") for unit in ("deg", "mm"))

# Settings of stages that evaluate points on a chain.
OF_CHAINS = tuple(
    f"mechanism.{name}"
    for name in (
        *("dh", "screws", "base", "tip", "gravity", "payload_kg", "payload_com_mm", "tolerance"),
        *("gear_orders", "pitch_mm"),
    )
)
NOISE_OF_JOINTS = ("noise.joint_deg", "noise.joint_mm")

_UNIT = {"rotary": "deg", "linear": "mm"}
_COUNTS = "_counts"


def _check_modulus(value: float) -> float:
    if value <= _STIFFEST_GPA:
        return value
    low, high = _LIKELY_GPA
    known = ((unit, value * factor) for unit, factor in _IN_GPA.items())
    meant = [f"{size:g} ({value:g} in {unit})" for unit, size in known if low <= size <= high]
    raise ValueError(f"at most {_STIFFEST_GPA:g}" + (f"; did you mean {' or '.join(meant)}?" if meant else ""))


def thin_rod(what: str, diameter_mm: float, length_mm: float | None) -> None:
    """Raise ValueError for a rod thinner than any real one, as with a diameter given in metres."""
    if length_mm and diameter_mm < _THINNEST * length_mm:
        raise ValueError(
            f"{what}.diameter_mm of at least 1/{1 / _THINNEST:g} of its length, {length_mm:g} mm; "
            f"did you mean {1e3 * diameter_mm:g} ({diameter_mm:g} in m)?"
        )


Modulus = Annotated[Positive, AfterValidator(_check_modulus)]
Poisson = Annotated[float, Field(gt=-1.0, lt=0.5)]


class Leg(Section):
    """One leg of a legged mechanism: joints, actuator direction and lengths."""

    a_mm: Vector = Field(description="zero point of the actuator on the base, base frame")
    b_mm: Vector = Field(description="joint on the platform, platform frame")
    u: Vector | None = Field(None, description="unit direction of the actuator, base frame")
    length_mm: Positive = Field(description="leg length (ups: at zero reading)")
    rho0_mm: Finite = Field(0.0, description="actuator reading in the reference configuration")
    flexure_length_mm: Positive | None = Field(None, description="length of the flexures at both ends")
    flexure_beta: Annotated[float, Field(ge=0.0, lt=0.75)] = Field(
        0.25,
        description="beam model: distance of the centre, on whose circle a flexure's end moves, from its root, in "
        "flexure lengths (beta of the telescope report)",
    )

    @model_validator(mode="after")
    def _direction_is_unit(self) -> Leg:
        if self.u is not None and abs(sum(c * c for c in self.u) - 1.0) > TYPED:
            raise ValueError("u: a vector of unit length")
        return self


class Rod(Section):
    """A circular elastic part: flexure or leg tube."""

    diameter_mm: Positive = Field(description="diameter")
    youngs_gpa: Modulus = Field(description="Young's modulus")
    poisson: Poisson = Field(description="Poisson's ratio")


class Tolerance(Section):
    """[mechanism.tolerance]: standard deviations of manufacturing and assembly, the prior of calibration."""

    a_mm: NotNegative | None = Field(None, description="each coordinate of the joints on the base")
    b_mm: NotNegative | None = Field(None, description="each coordinate of the joints on the platform")
    u: Share | None = Field(None, description="direction of the actuators, rad")
    length_mm: NotNegative | None = Field(None, description="leg length")
    rho0_mm: NotNegative | None = Field(None, description="reference reading of the actuators")
    flexure_length_mm: NotNegative | None = Field(
        None, description="length of the flexures; given: beam and stiffness model identify it"
    )
    flexure_beta: NotNegative | None = Field(None, description="flexure_beta; given: the beam model identifies it")


class MechanismSection(Section):
    """Base of all types of [mechanism]."""

    type: Name = Field(description="6-pus, ups, 6-upur, axis, chain, none, or a type of an installed package")
    reference_temperature_c: Temperature = Field(
        20.0, description="temperature of the survey and of the nominal geometry"
    )

    @property
    def is_legged(self) -> bool:
        """True if legs with actuators carry a platform, so that readings determine its pose."""
        return self.type not in WITHOUT_LEGS


def _known_closure(kind: str) -> str:
    """Accept own types first, because the query of installed packages is slow."""
    if kind not in OF_LEGS:
        added = sorted(entry_points(group=CLOSURES).names)
        if kind not in added:
            known = (*OF_LEGS, *WITHOUT_LEGS, *added)
            raise ValueError(f"one of {', '.join(known)}{did_you_mean(kind, known)}")
    return kind


class NoMechanism(MechanismSection):
    """[mechanism] absent or type = "none": bodies of any names, without a model of their motion."""

    type: Literal["none"] = Field("none", description="none: bodies of any names")


class LeggedMechanism(MechanismSection):
    """[mechanism] of type 6-pus, ups or that of an installed package: nominal geometry and its tolerance."""

    type: Annotated[str, AfterValidator(_known_closure)] = Field(
        description="6-pus: fixed legs, moved actuators; ups: legs of variable length; or a type of an installed "
        "package"
    )
    legs: tuple[Leg, ...] = Field(description="one entry per leg, in leg order")
    flexure: Rod | None = Field(None, description="stiffness model: the flexures")
    leg_tube: Rod | None = Field(None, description="stiffness model: the legs")
    stiffness_along_motion: bool = Field(
        False,
        description="one more model, stiffness-along: the stiffness of each leg has its mean direction between the "
        "reference and the pose, instead of that at the reference",
    )
    tolerance: Tolerance = Field(Tolerance(), description="prior uncertainty of the geometry")
    actuator_pitch_mm: Positive | None = Field(None, description="lead of the actuators' leadscrews")
    actuator_accuracy_mm: OneOrSeveral | None = Field(
        None, description="largest error of an actuator, ±, as specified: one number, or one per leg"
    )
    payload_kg: Positive | None = Field(
        None,
        description="mass that the legs carry, platform included; a column of configurations.csv with this name has "
        "precedence",
    )
    payload_com_mm: Vector = Field((0.0, 0.0, 0.0), description="centre of gravity of this mass, platform frame")
    deformation_file: Path | None = Field(
        None,
        description="simulated deformation of the platform: K, its entries with sigma, or a table of shifts; compared "
        "with the measured K",
    )
    model: Path | None = Field(None, description="model.toml of an earlier campaign of this machine, as a start")

    @property
    def is_elastic(self) -> bool:
        """True if flexures and legs are known, so that the stiffness model can include loads."""
        known = self.flexure is not None and self.leg_tube is not None
        return known and len(self.legs) == 6 and all(leg.flexure_length_mm is not None for leg in self.legs)

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
    def _accuracies_fit_the_legs(self) -> LeggedMechanism:
        accuracies = self.actuator_accuracy_mm
        if isinstance(accuracies, tuple) and len(accuracies) != len(self.legs):
            raise ValueError(f"one actuator_accuracy_mm, or {len(self.legs)}, one per leg, not {len(accuracies)}")
        return self

    @model_validator(mode="after")
    def _parts_are_no_longer_than_the_legs(self) -> LeggedMechanism:
        """Reject a tolerance or flexure longer than a leg: a wrong decimal point or unit."""
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


class SensorLeg(Section):
    """One leg of a 6-upur: its joint centres."""

    B_mm: Vector = Field(description="lower joint centre, fixed frame")
    b_mm: Vector = Field(description="upper joint centre, platform frame")


# Required keys by kind; a rigid element without length fills the rest of its leg, a notch is 2 radius long.
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
_SOLID = ("cylinder", "leaf", "notch")  # kinds with a volume
_LIGHTEST, _DENSEST = 30.0, 30e3  # kg/m^3: from rigid foam to above osmium, 22.6e3


def _check_density(value: float) -> float:
    if not _LIGHTEST <= value <= _DENSEST:
        meant = f"; did you mean {1e3 * value:g} ({value:g} in g/cm3)?" if value < _LIGHTEST else ""
        raise ValueError(f"from {_LIGHTEST:g} to {_DENSEST:g} kg/m3{meant}")
    return value


Density = Annotated[float, Field(gt=0.0, allow_inf_nan=False), AfterValidator(_check_density)]


class SensorPlate(Section):
    """[mechanism.platform], [mechanism.base]: a plate that holds the joints, its elasticity and weight."""

    thickness_mm: Positive = Field(description="thickness")
    rigid_radius_mm: Positive = Field(description="radius of its rigid middle, where the load acts or the base is held")
    outer_radius_mm: Positive | None = Field(
        None, description="radius of the disc, for its mass; absent: of its joints"
    )
    youngs_gpa: Modulus = Field(description="Young's modulus")
    poisson: Poisson = Field(description="Poisson's ratio")
    density_kg_m3: Density | None = Field(None, description="density; absent: without weight")
    mass_kg: Positive | None = Field(None, description="mass, instead of that of a full disc by density")
    com_mm: Vector = Field((0.0, 0.0, 0.0), description="platform: centre of gravity, platform frame")
    elastic: bool = Field(
        False, description="whether the simulation contains the plate's elasticity; otherwise its neglect is tested"
    )

    @model_validator(mode="after")
    def _mass_once(self) -> SensorPlate:
        if self.density_kg_m3 is not None and self.mass_kg is not None:
            raise ValueError("density_kg_m3 or mass_kg, not both")
        return self


class SensorElement(Section):
    """One element of a sensor's leg, from the base to the platform; its kind determines its keys."""

    kind: Literal["cylinder", "leaf", "notch", "spring", "rigid", "compliance"] = Field(
        description="kind of the element"
    )
    length_mm: NotNegative | None = Field(
        None, description="length along the leg; absent: a rigid element fills the rest of the leg"
    )
    diameter_mm: Positive | None = Field(None, description="cylinder: diameter")
    width_mm: Positive | None = Field(None, description="leaf, notch: width across the leg")
    thickness_mm: Positive | None = Field(None, description="leaf: thickness")
    web_mm: Positive | None = Field(None, description="notch: smallest thickness")
    radius_mm: Positive | None = Field(None, description="notch: radius")
    soft: Literal["s1", "s2"] | None = Field(None, description="leaf, notch: axis of bending")
    youngs_gpa: Modulus | None = Field(None, description="Young's modulus")
    poisson: Poisson | None = Field(None, description="Poisson's ratio")
    axial_n_per_m: Positive | None = Field(None, description="spring: stiffness along the leg; absent: rigid")
    torsion_n_m_per_rad: Positive | None = Field(None, description="spring: stiffness about the leg; absent: rigid")
    matrix: tuple[tuple[Finite, ...], ...] | None = Field(
        None, description="compliance: 6 x 6 matrix, SI, at the element's outer end"
    )
    density_kg_m3: Density | None = Field(None, description="cylinder, leaf, notch: density, for its weight")
    mass_kg: Positive | None = Field(None, description="mass, for its weight, instead of density_kg_m3")

    @model_validator(mode="after")
    def _keys_fit_the_kind(self) -> SensorElement:
        needed, kind = _NEEDED[self.kind], f"for kind {self.kind}"
        keys_given = {name for name in self.model_fields_set if getattr(self, name) is not None} - {"kind"}
        if lacking := [name for name in needed if name not in keys_given]:
            raise ValueError(f"{', '.join(lacking)} {kind}")
        of_weight = ("mass_kg", "density_kg_m3") if self.kind in _SOLID else ("mass_kg",)
        if foreign := sorted(keys_given - {*needed, *_ALLOWED.get(self.kind, ()), *of_weight}):
            allowed = ", ".join(_ALLOWED.get(self.kind, needed))
            raise ValueError(f"{allowed} {kind}, not {', '.join(foreign)}")
        if self.density_kg_m3 is not None and self.mass_kg is not None:
            raise ValueError(f"density_kg_m3 or mass_kg {kind}, not both")
        if self.kind == "cylinder":
            thin_rod("cylinder", self.diameter_mm or 0.0, self.length_mm)
        diameter = 2.0 * (self.radius_mm or 0.0)
        if self.kind == "notch" and abs((self.length_mm or diameter) - diameter) > TYPED * diameter:
            raise ValueError(f"length_mm to be 2 radius_mm, {diameter:g}, {kind}; absent: this value")
        rows = [len(row) for row in self.matrix or ()]
        if rows and rows != [6] * 6:
            raise ValueError(f"a matrix of 6 x 6 numbers, not rows of {', '.join(map(str, rows))}")
        return self


class SensorTolerance(Section):
    """[mechanism.tolerance] of a 6-upur: full widths T, with sigma = T / 6."""

    platform_radius_um: NotNegative | None = Field(None, description="radius of the upper joints")
    base_radius_um: NotNegative | None = Field(None, description="radius of the lower joints")
    lower_clearance_um: NotNegative | None = Field(None, description="clearance of the lower joint")
    middle_clearance_um: NotNegative | None = Field(None, description="clearance of the middle joint")
    sensor_installation_um: NotNegative | None = Field(None, description="installation of the cell in its leg")
    stiffness: Share = Field(0.0, description="relative standard deviation of the elastic parameters")


class SensorMechanism(MechanismSection):
    """[mechanism] of type 6-upur: joint centres, and the elements of one leg or the compliance."""

    type: Literal["6-upur"] = Field(description="a force sensor of six elastic legs")
    legs: tuple[SensorLeg, ...] = Field(min_length=6, max_length=6, description="six entries, in leg order")
    height_mm: Positive = Field(description="height of the platform's origin above the fixed frame's, without load")
    elements: tuple[SensorElement, ...] = Field((), description="elements of one leg, from the base to the platform")
    compliance_file: Path | None = Field(None, description="simulated compliance, 6 x 6, SI, instead of elements")
    platform: SensorPlate | None = Field(None, description="plate of the upper joints: elasticity and weight")
    base: SensorPlate | None = Field(None, description="plate of the lower joints: elasticity")
    tolerance: SensorTolerance = Field(SensorTolerance(), description="prior uncertainty of geometry and stiffness")
    model: Path | None = Field(None, description="model.toml of an earlier campaign of this sensor, as a start")

    @model_validator(mode="after")
    def _one_simulation(self) -> SensorMechanism:
        if self.elements and self.compliance_file is not None:
            raise ValueError("either elements or compliance_file, not both")
        return self

    @model_validator(mode="after")
    def _plates_fit_the_joints(self) -> SensorMechanism:
        joints = {"platform": [leg.b_mm for leg in self.legs], "base": [leg.B_mm for leg in self.legs]}
        for name, points in joints.items():
            plate, radius = getattr(self, name), min(math.hypot(*point[:2]) for point in points)
            if plate is None:
                continue
            if plate.rigid_radius_mm >= radius:
                raise ValueError(f"{name}.rigid_radius_mm below {radius:g} mm (joints), not {plate.rigid_radius_mm:g}")
            if plate.elastic and not self.elements:
                raise ValueError(f"elements, because {name}.elastic adds to their compliance")
        return self


class AxisMechanism(MechanismSection):
    """[mechanism] of type axis: columns of configurations.csv with its command and its encoders."""

    type: Literal["axis"] = Field(description="one rotary or linear axis")
    kind: Literal["rotary", "linear"] = Field(description="rotary: angles in degrees; linear: lengths in mm")
    command: Name = Field(description="column of the command: ..._deg, ..._mm or ..._counts")
    motor: Name | None = Field(None, description="column of the motor encoder")
    load: Name | None = Field(None, description="column of the load encoder, after the transmission")
    loop: Literal["motor", "load"] = Field(
        "motor", description="encoder in the controller's feedback loop, recorded or not"
    )
    counts_per_deg: Positive | None = Field(
        None, description="rotary: counts per degree, for columns that end in _counts"
    )
    counts_per_mm: Positive | None = Field(None, description="linear: counts per mm, for columns that end in _counts")
    period_deg: Positive | None = Field(
        None, description="rotary: period of a periodic error, such as of a worm; absent: searched"
    )
    period_mm: Positive | None = Field(
        None, description="linear: period of a periodic error, such as a screw's lead; absent: searched"
    )
    travel_deg: tuple[Finite, Finite] | None = Field(
        None, description="rotary: lowest and highest command to plan with; absent: those of configurations.csv"
    )
    travel_mm: tuple[Finite, Finite] | None = Field(
        None, description="linear: lowest and highest command to plan with; absent: those of configurations.csv"
    )

    @property
    def unit(self) -> str:
        """Unit of the axis in tables: deg or mm."""
        return _UNIT[self.kind]

    @property
    def columns(self) -> dict[str, str]:
        """Columns named in the section, by content: command, motor, load."""
        named = {"command": self.command, "motor": self.motor, "load": self.load}
        return {what: column for what, column in named.items() if column is not None}

    @property
    def counts_per_unit(self) -> float | None:
        """Counts per degree or per mm; None if no column is in counts."""
        return self.counts_per_deg if self.kind == "rotary" else self.counts_per_mm

    @property
    def period(self) -> float | None:
        """Declared period of a periodic error in degrees or mm; None if it is searched."""
        return self.period_deg if self.kind == "rotary" else self.period_mm

    @property
    def travel(self) -> tuple[float, float] | None:
        """Declared lowest and highest command in degrees or mm."""
        return self.travel_deg if self.kind == "rotary" else self.travel_mm

    @model_validator(mode="after")
    def _columns_fit_the_kind(self) -> AxisMechanism:
        unit = _UNIT[self.kind]
        for what, column in self.columns.items():
            if not column.endswith((f"_{unit}", _COUNTS)):
                raise ValueError(f"a column ..._{unit} or ...{_COUNTS} as {what} of a {self.kind} axis, not {column}")
            if column.endswith(_COUNTS) and self.counts_per_unit is None:
                raise ValueError(f"counts_per_{unit}, because column {column} is in counts")
        if len(set(self.columns.values())) < len(self.columns):
            raise ValueError("different columns for command, motor and load")
        counts_of_other_kind = self.counts_per_mm if self.kind == "rotary" else self.counts_per_deg
        if counts_of_other_kind is not None:
            raise ValueError(f"counts_per_{unit} for a {self.kind} axis")
        if (self.period_mm if self.kind == "rotary" else self.period_deg) is not None:
            raise ValueError(f"period_{unit} for a {self.kind} axis")
        if (self.travel_mm if self.kind == "rotary" else self.travel_deg) is not None:
            raise ValueError(f"travel_{unit} for a {self.kind} axis")
        if self.travel is not None and self.travel[0] >= self.travel[1]:
            raise ValueError(f"the lowest command before the highest in travel_{unit}")
        return self
