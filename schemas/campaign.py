"""What campaign.toml may hold, key by key; anything else is a fault with a suggestion."""

from __future__ import annotations

import difflib
from importlib.metadata import entry_points
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from schemas.faults import CampaignFaults, Fault
from schemas.interferometer import Interferometer
from schemas.mapping import FileMapping
from schemas.section import Finite, NotNegative, Positive, Section, Vector

# A lab's package names its own closures of a leg under this group: `"my-type" = "my_package.legs:MyLeg"`.
CLOSURES = "truing.closures"
# A direction that a person types has four digits or so.
_TYPED = 1e-3


class CampaignSection(Section):
    """[campaign]: its name, its kind, and the columns that deformation may follow."""

    name: str = Field(pattern=r"^[^/\\:*?\"<>|\x00-\x1f]{1,120}$", description="names the run's folder")
    kind: Literal["photogrammetry", "interferometer"]
    drives: tuple[str, ...] = Field((), description="columns of configurations.csv that deformation may follow")


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
        if self.u is not None and abs(sum(c * c for c in self.u) - 1.0) > _TYPED:
            raise ValueError("u must have unit length")
        return self


class Rod(Section):
    """A circular elastic part: flexure or leg tube."""

    diameter_mm: Positive
    youngs_gpa: Positive
    poisson: Annotated[float, Field(gt=-1.0, lt=0.5)]


class Tolerance(Section):
    """[mechanism.tolerance]: one standard deviation of manufacturing and assembly, the prior of calibration."""

    a_mm: NotNegative | None = None
    b_mm: NotNegative | None = None
    u: NotNegative | None = None
    length_mm: NotNegative | None = None
    rho0_mm: NotNegative | None = None


class MechanismSection(Section):
    """[mechanism], whatever its type."""

    type: str
    reference_temperature_c: Finite = 20.0

    @property
    def is_legged(self) -> bool:
        """Whether legs with actuators carry a platform, whose readings say where it is."""
        return self.type not in ("none", "6-upur")


def _known_closure(kind: str) -> str:
    """Own types first: asking what is installed takes time."""
    if kind not in ("6-pus", "ups"):
        added = sorted(entry_points(group=CLOSURES).names)
        if kind not in added:
            raise ValueError(f"one of {', '.join(('6-pus', 'ups', '6-upur', 'none', *added))}")
    return kind


class NoMechanism(MechanismSection):
    """[mechanism] absent or type = "none": bodies of any names, and nothing that says how they move."""

    type: Literal["none"] = "none"


class LeggedMechanism(MechanismSection):
    """[mechanism] of type 6-pus, ups or an installed package's own: nominal geometry and its tolerance."""

    type: Annotated[str, AfterValidator(_known_closure)]
    legs: tuple[Leg, ...]
    flexure: Rod | None = None
    leg_tube: Rod | None = None
    tolerance: Tolerance = Tolerance()
    actuator_pitch_mm: Positive | None = Field(None, description="pitch of the actuators' leadscrew")
    model: str | None = Field(None, description="model.toml of an earlier campaign of this machine, to start from")

    @model_validator(mode="after")
    def _legs_fit_the_type(self) -> LeggedMechanism:
        if self.type == "6-pus" and len(self.legs) != 6:
            raise ValueError(f"six legs for a 6-pus, not {len(self.legs)}")
        if self.type == "6-pus" and any(leg.u is None for leg in self.legs):
            raise ValueError("the actuator direction u for every leg of a 6-pus")
        if len(self.legs) < 3:
            raise ValueError(f"at least three legs for a {self.type}, not {len(self.legs)}")
        return self


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

    kind: Literal["cylinder", "leaf", "notch", "spring", "rigid", "compliance"]
    length_mm: NotNegative | None = Field(None, description="along the leg; absent: rigid takes up what is left of it")
    diameter_mm: Positive | None = None
    width_mm: Positive | None = None
    thickness_mm: Positive | None = None
    web_mm: Positive | None = None
    radius_mm: Positive | None = None
    soft: Literal["s1", "s2"] | None = None
    youngs_gpa: Positive | None = None
    poisson: Annotated[float, Field(gt=-1.0, lt=0.5)] | None = None
    axial_n_per_m: Positive | None = None
    torsion_n_m_per_rad: Positive | None = None
    matrix: tuple[tuple[Finite, ...], ...] | None = None

    @model_validator(mode="after")
    def _keys_fit_the_kind(self) -> Element:
        needed, kind = _NEEDED[self.kind], f"for kind {self.kind}"
        given = {name for name in self.model_fields_set if getattr(self, name) is not None} - {"kind"}
        if lacking := [name for name in needed if name not in given]:
            raise ValueError(f"{', '.join(lacking)} {kind}")
        if foreign := sorted(given - {*needed, *_ALLOWED.get(self.kind, ())}):
            allowed = ", ".join(_ALLOWED.get(self.kind, needed))
            raise ValueError(f"{allowed} {kind}, not {', '.join(foreign)}")
        own = 2.0 * (self.radius_mm or 0.0)
        if self.kind == "notch" and abs((self.length_mm or own) - own) > _TYPED * own:
            raise ValueError(f"length_mm to be 2 radius_mm, {own:g}, {kind}; absent it is that")
        rows = [len(row) for row in self.matrix or ()]
        if rows and rows != [6] * 6:
            raise ValueError(f"a matrix of 6 x 6 numbers, not rows of {', '.join(map(str, rows))}")
        return self


class SensorTolerance(Section):
    """[mechanism.tolerance] of a 6-upur: full widths T, sigma = T / 6."""

    platform_radius_um: NotNegative | None = None
    base_radius_um: NotNegative | None = None
    lower_clearance_um: NotNegative | None = None
    middle_clearance_um: NotNegative | None = None
    sensor_installation_um: NotNegative | None = None
    stiffness: NotNegative = Field(0.0, description="one sigma, relative, of the elastic parameters")


class SensorMechanism(MechanismSection):
    """[mechanism] of type 6-upur: joint centres, and the elements of one leg or the compliance itself."""

    type: Literal["6-upur"]
    legs: tuple[SensorLeg, ...] = Field(min_length=6, max_length=6)
    height_mm: Positive
    elements: tuple[Element, ...] = ()
    compliance_file: str | None = Field(None, description="the simulated compliance, 6 x 6, SI, instead of elements")
    tolerance: SensorTolerance = SensorTolerance()
    model: str | None = Field(None, description="model.toml of an earlier campaign of this sensor, to start from")

    @model_validator(mode="after")
    def _one_simulation(self) -> SensorMechanism:
        if self.elements and self.compliance_file is not None:
            raise ValueError("either elements or compliance_file, not both")
        return self


def _tag(section: Any) -> str:
    kind = section.get("type", "none") if isinstance(section, dict) else getattr(section, "type", "none")
    return kind if kind in ("none", "6-upur") else "legged"


Mechanism = Annotated[
    Annotated[LeggedMechanism, Tag("legged")]
    | Annotated[SensorMechanism, Tag("6-upur")]
    | Annotated[NoMechanism, Tag("none")],
    Discriminator(_tag),
]


class Loading(Section):
    """[loading]: the range of each load; beyond it a load is a fault."""

    fx_n: Positive | None = None
    fy_n: Positive | None = None
    fz_n: Positive | None = None
    mx_nm: Positive | None = None
    my_nm: Positive | None = None
    mz_nm: Positive | None = None


class Signals(Section):
    """[signals]: what is known of the gain of the signal channels."""

    sensitivity_mv_per_n: Positive | tuple[Positive, ...] | None = None
    sensitivity_tolerance: NotNegative | None = None
    zero_mv: NotNegative | None = Field(
        None, description="one sigma of a signal's zero where each run was tared; absent: unknown"
    )
    range_mv: Positive | None = Field(None, description="what the amplifier passes either way; at it, a signal is cut")


class Workspace(Section):
    """[workspace]: half ranges, for pose selection and the requirements table."""

    x_mm: Positive | None = None
    y_mm: Positive | None = None
    z_mm: Positive | None = None
    rx_deg: Positive | None = None
    ry_deg: Positive | None = None
    rz_deg: Positive | None = None
    rho_mm: Positive | None = None


class Requirement(Section):
    """[requirement]: desired accuracy."""

    x_mm: Positive | None = None
    y_mm: Positive | None = None
    z_mm: Positive | None = None
    rx_deg: Positive | None = None
    ry_deg: Positive | None = None
    rz_deg: Positive | None = None


class Noise(Section):
    """[noise]: one standard deviation, as specified for the instrument."""

    point_mm: Positive | None = None
    actuator_mm: NotNegative = 0.0
    linear_um: Positive | None = Field(None, description="interferometer, linear channels")
    angular_arcsec: Positive | None = Field(None, description="interferometer, angular channels")
    signal_mv: Positive | None = Field(None, description="signal channels")
    displacement_mm: Positive | None = Field(None, description="six-component displacement, translation")
    rotation_rad: Positive | None = Field(None, description="six-component displacement, rotation")
    load_n: NotNegative = Field(0.0, description="applied force")
    load_nm: NotNegative = Field(0.0, description="applied torque")


class Bodies(Section):
    """[bodies]: which body the others are seen from; absent, poses are in the measurement frame.

    ``still`` names bodies that should stand still before an instrument whose frame is one for the campaign.
    """

    reference: str | None = None
    still: tuple[str, ...] = ()


class Diagnosis(Section):
    """[diagnosis]: how sure a finding must be."""

    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.05
    seed: int = Field(0, ge=0, description="seed of the simulated null draws")


class QualityLimits(Section):
    """[qa]: the probability that all failing checks together trip on a good campaign."""

    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.01


class Overrule(Section):
    """[[exclude]], [[keep]]: a point or a reading left out or kept by a person, by name and with a reason.

    An absent key stands for all: ``body = "platform", target = "P07"`` concerns that target in every pose, ``run = 3,
    channel = "dz"`` that channel in every step of the run.
    """

    pose: int | str | None = None
    body: str | None = None
    target: str | None = None
    run: int | str | None = Field(None, description="interferometer: the run")
    step: int | None = Field(None, description="interferometer: the load step within its run")
    channel: Literal["dx", "dy", "dz", "rx", "ry", "rz", "v1", "v2", "v3", "v4", "v5", "v6", "v7", "v8"] | None = Field(
        None, description="interferometer: what was read"
    )
    by: str = Field(min_length=1, description="who decided")
    reason: str = Field(min_length=1)


class Acceptance(Section):
    """[[accept]]: a QA verdict accepted by a person, by name and with a reason."""

    check: str = Field(min_length=1)
    subject: str | None = None
    by: str = Field(min_length=1, description="who decided")
    reason: str = Field(min_length=1)


def _typed(section: Any) -> Any:
    return {"type": "none", **section} if isinstance(section, dict) else section


def _listed(entry: Any) -> Any:
    return (entry,) if isinstance(entry, dict) else entry


class Campaign(Section):
    """campaign.toml as a whole."""

    format: Literal[1] = 1
    campaign: CampaignSection
    mechanism: Annotated[Mechanism, BeforeValidator(_typed)] = NoMechanism()
    loading: Loading = Loading()
    interferometer: Interferometer = Interferometer()
    signals: Signals = Signals()
    workspace: Workspace = Workspace()
    requirement: Requirement = Requirement()
    noise: Noise = Noise()
    bodies: Bodies = Bodies()
    diagnosis: Diagnosis = Diagnosis()
    qa: QualityLimits = QualityLimits()
    exclude: tuple[Overrule, ...] = ()
    keep: tuple[Overrule, ...] = ()
    accept: tuple[Acceptance, ...] = ()
    files: dict[str, Annotated[tuple[FileMapping, ...], BeforeValidator(_listed)]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _overrules_fit_the_kind(self) -> Campaign:
        if self.campaign.kind == "photogrammetry":
            of_benches = [
                rule for rule in (*self.exclude, *self.keep) if (rule.run, rule.step, rule.channel) != (None,) * 3
            ]
            if of_benches:
                raise ValueError(
                    "pose, body or target in [[exclude]] and [[keep]]: run, step and channel are a bench's"
                )
        return self

    @property
    def reference_body(self) -> str | None:
        """The body that the others are seen from: ``base`` where a mechanism stands on one."""
        if self.bodies.reference is None and self.mechanism.is_legged:
            return "base"
        return self.bodies.reference


def read_campaign(document: dict[str, Any], file: str = "campaign.toml") -> Campaign:
    """The campaign that a parsed campaign.toml describes; raises CampaignFaults with every fault at once."""
    try:
        return Campaign.model_validate(document)
    except ValidationError as error:
        raise CampaignFaults(_fault(file, detail) for detail in error.errors()) from None


# The library writes a bound with all its digits.
_BOUNDS = {"less_than_equal": ("at most", "le"), "greater_than_equal": ("at least", "ge")}
_TYPES = {"legged": LeggedMechanism, "6-upur": SensorMechanism, "none": NoMechanism}


def _fault(file: str, detail: Any) -> Fault:
    location = tuple(part for part in detail["loc"] if part not in _TYPES)
    path = ".".join(str(part + 1) if isinstance(part, int) else part for part in location)
    if detail["type"] == "extra_forbidden":
        return Fault(file, _suggestion(detail["loc"]), column=path)
    if detail["type"] == "missing":
        return Fault(file, "this key to be present", column=path)
    value = detail["input"]
    shown = None if isinstance(value, (dict, list, tuple)) else str(value)[:80]
    return Fault(file, _wanted(detail), column=path, value=shown)


def _wanted(detail: Any) -> str:
    word, key = _BOUNDS.get(detail["type"], ("", ""))
    if word:
        return f"{word} {detail['ctx'][key]:g}"
    return str(detail["msg"]).removeprefix("Value error, ").removeprefix("Input should be ")


def _suggestion(location: tuple[int | str, ...]) -> str:
    section: Any = Campaign
    for part in location[:-1]:
        section = _TYPES.get(str(part)) or _step(section, part)
    known = list(section.model_fields)
    close = difflib.get_close_matches(str(location[-1]), known, n=1)
    return f"a known key; did you mean {close[0]}?" if close else f"a known key, one of: {', '.join(known)}"


def _step(section: Any, part: int | str) -> Any:
    """The model one key further down; where the key is an index or a table's name, the same model."""
    field = section.model_fields.get(part)
    return section if field is None else _inner_model(field.annotation) or section


def _inner_model(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    arguments = getattr(annotation, "__args__", ())
    return next((found for argument in arguments if (found := _inner_model(argument)) is not None), None)
