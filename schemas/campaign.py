"""Model of campaign.toml; every fault is reported, an unknown key with the nearest known one."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, Discriminator, Field, Tag, ValidationError, model_validator
from pydantic_core import ErrorDetails

from truing.schemas.certificate import Certificate
from truing.schemas.chain_mechanism import ChainMechanism
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.interferometer import Interferometer
from truing.schemas.mapping import OF_NAME, OF_TABLE, FileMapping
from truing.schemas.mechanism import AxisMechanism, LeggedMechanism, MechanismSection, NoMechanism, SensorMechanism
from truing.schemas.near_names import did_you_mean
from truing.schemas.photographs import GivenCamera, Photographs
from truing.schemas.quality_checks import acceptance_faults, limit_faults
from truing.schemas.section import Section
from truing.schemas.sections import (
    Acceptance,
    Bodies,
    CalibrationSection,
    CampaignSection,
    Comment,
    Diagnosis,
    ExternalLoad,
    Loading,
    MeasuredPoses,
    Measurement,
    Noise,
    Overrule,
    QualityLimits,
    Renamed,
    Requirement,
    Resurvey,
    Signals,
    Workspace,
)
from truing.schemas.settings_text import Document


def _check_format(value: object) -> int:
    if value != 1 or not isinstance(value, int) or isinstance(value, bool):
        raise ValueError("1")
    return value


# Sections of [mechanism] by tag; no key has such a name. All other types have legs.
_TYPES: dict[str, type[MechanismSection]] = {
    "legged": LeggedMechanism,
    "6-upur": SensorMechanism,
    "one-axis": AxisMechanism,
    "open-chain": ChainMechanism,
    "none": NoMechanism,
}
_TAGS = {"6-upur": "6-upur", "axis": "one-axis", "chain": "open-chain", "none": "none"}


def _tag(section: object) -> str:
    kind = section.get("type", "none") if isinstance(section, dict) else getattr(section, "type", "none")
    return _TAGS.get(kind, "legged") if isinstance(kind, str) else "legged"


Mechanism = Annotated[
    Annotated[LeggedMechanism, Tag("legged")]
    | Annotated[SensorMechanism, Tag("6-upur")]
    | Annotated[AxisMechanism, Tag("one-axis")]
    | Annotated[ChainMechanism, Tag("open-chain")]
    | Annotated[NoMechanism, Tag("none")],
    Discriminator(_tag),
]


def _typed(section: object) -> object:
    return {"type": "none", **section} if isinstance(section, dict) else section


def _listed(entry: object) -> object:
    if isinstance(entry, dict):
        return (entry,)
    if not isinstance(entry, tuple) or not all(isinstance(item, dict) for item in entry):
        raise ValueError("a table, or several: path = .., columns = ..")
    return entry


class Campaign(Section):
    """All of campaign.toml."""

    format: Annotated[Literal[1], BeforeValidator(_check_format)] = 1
    campaign: CampaignSection
    mechanism: Annotated[Mechanism, BeforeValidator(_typed)] = NoMechanism()
    loading: Loading = Loading()
    load: ExternalLoad = ExternalLoad()
    interferometer: Interferometer = Interferometer()
    signals: Signals = Signals()
    photographs: Photographs = Photographs()
    cameras: tuple[GivenCamera, ...] = ()
    workspace: Workspace = Workspace()
    requirement: Requirement = Requirement()
    noise: Noise = Noise()
    measurement: Measurement = Measurement()
    poses: MeasuredPoses = MeasuredPoses()
    bodies: Bodies = Bodies()
    calibration: CalibrationSection = CalibrationSection()
    diagnosis: Diagnosis = Diagnosis()
    qa: QualityLimits = QualityLimits()
    exclude: tuple[Overrule, ...] = ()
    keep: tuple[Overrule, ...] = ()
    accept: tuple[Acceptance, ...] = ()
    renamed: tuple[Renamed, ...] = ()
    resurvey: tuple[Resurvey, ...] = ()
    comment: tuple[Comment, ...] = ()
    certificate: Certificate = Certificate()
    files: dict[str, Annotated[tuple[FileMapping, ...], BeforeValidator(_listed)]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _overrules_fit_the_kind(self) -> Campaign:
        if self.campaign.kind == "photogrammetry":
            of_benches = [
                rule for rule in (*self.exclude, *self.keep) if (rule.run, rule.step, rule.channel) != (None,) * 3
            ]
            if of_benches:
                raise ValueError(
                    "pose, body or target in [[exclude]] and [[keep]]; run, step and channel are keys for a bench"
                )
        elif self.renamed or self.resurvey:
            raise ValueError("no [[renamed]] and no [[resurvey]], because a bench has no targets")
        return self

    @model_validator(mode="after")
    def _up_has_a_frame(self) -> Campaign:
        if self.measurement.up is not None and self.reference_body is None and not self.is_frame_fixed:
            raise ValueError(
                '[bodies] reference, or frame = "campaign", with [measurement] up, because a frame that changes with '
                "each pose has no fixed upward direction"
            )
        return self

    @property
    def reference_body(self) -> str | None:
        """Body in whose frame the others are given; ``base`` by default for a mechanism with legs."""
        if self.bodies.reference is None and self.mechanism.is_legged:
            return "base"
        return self.bodies.reference

    @property
    def is_frame_fixed(self) -> bool:
        """True if one instrument frame holds for the whole campaign, or on a chain for each series."""
        if self.mechanism.type == "chain" and self.measurement.frame == "series":
            return True
        return self.measurement.frame == "campaign"


def read_campaign(document: dict[str, object], file: str = "campaign.toml") -> Campaign:
    """Validate a parsed campaign.toml; raises CampaignFaults with every fault."""
    try:
        campaign = Campaign.model_validate(document)
    except ValidationError as error:
        raise CampaignFaults(_fault(file, document, detail) for detail in error.errors()) from None
    kind = campaign.campaign.kind
    faults = [*limit_faults(file, kind, campaign.qa.limits), *acceptance_faults(file, kind, campaign.accept)]
    if faults := [
        *faults,
        *_joint_faults(file, campaign),
        *_axis_faults(file, campaign),
        *_load_limit_faults(file, campaign),
    ]:
        raise CampaignFaults(faults)
    return campaign


def _joint_faults(file: str, campaign: Campaign) -> Iterator[Fault]:
    """Yield the joints of [workspace] where [mechanism] has none."""
    if campaign.mechanism.type != "chain":
        text = 'no such key, because only a [mechanism] of type "chain" has joints'
        yield from (Fault(file, text, column=f"workspace.joints.{name}") for name in campaign.workspace.joints)


def _axis_faults(file: str, campaign: Campaign) -> Iterator[Fault]:
    """Yield the limits of [requirement] that an axis cannot have: of the other unit, or a second one."""
    if not isinstance(campaign.mechanism, AxisMechanism):
        return
    limits = {name: value for name, value in campaign.requirement if value is not None}
    unit = campaign.mechanism.unit
    fitting = [name for name in limits if name.endswith(f"_{unit}")]
    for name, value in limits.items():
        if name not in fitting[:1]:
            known = ", ".join(key for key in type(campaign.requirement).model_fields if key.endswith(f"_{unit}"))
            text = f"one limit for the axis, whatever its direction is called: one of {known}"
            yield Fault(file, text, column=f"requirement.{name}", value=f"{value:g}")


def _load_limit_faults(file: str, campaign: Campaign) -> Iterator[Fault]:
    """Yield the limits of [requirement] on loads where no load is measured."""
    if campaign.campaign.kind == "interferometer":
        return
    for name, value in campaign.requirement.of_loads().items():
        text = 'no such key, because only a force sensor (kind = "interferometer") measures loads'
        yield Fault(file, text, column=f"requirement.{name}", value=f"{value:g}")


# Bounds are shortened here, because pydantic writes all their digits.
_BOUNDS = {
    "less_than_equal": ("at most", "le"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "greater_than": ("greater than", "gt"),
}
# Expected types by pydantic's error types.
_KINDS = {
    "float_type": "a number, without quotation marks",
    "int_type": "a whole number, without quotation marks",
    "int_from_float": "a whole number",
    "bool_type": "true or false, without quotation marks",
    "string_type": "text, in quotation marks",
    "tuple_type": "a list, in brackets",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "finite_number": "a finite number",
}


def _fault(file: str, document: dict[str, object], detail: ErrorDetails) -> Fault:
    path = _dotted(detail["loc"], document)
    if detail["type"] == "extra_forbidden":
        return Fault(file, _suggestion(detail["loc"]), column=path)
    if detail["type"] == "missing":
        return Fault(file, "this key to be present", column=path)
    is_type = detail["type"] in _KINDS
    return Fault(file, _expectation(detail), column=path, value=_printable_value(detail["input"], quoted=is_type))


def _dotted(location: tuple[int | str, ...], document: Document) -> str:
    """Key path as in campaign.toml: list entries count from 1, and a single table has no number."""
    parts: list[str] = []
    level: Any = document
    for part in location:
        if part in (*_TYPES, OF_NAME, OF_TABLE, "[key]") or (isinstance(part, int) and isinstance(level, dict)):
            continue
        parts.append(str(part + 1) if isinstance(part, int) else part)
        try:
            level = level[part]
        except (KeyError, IndexError, TypeError):
            level = {}
    return ".".join(parts)


def _printable_value(value: object, *, quoted: bool) -> str | None:
    """A value as a fault shows it, in TOML notation for a wrong type."""
    if isinstance(value, (dict, list, tuple)):
        return None
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"'[:80] if quoted and isinstance(value, str) else str(value)[:80]


def _expectation(detail: ErrorDetails) -> str:
    word, key = _BOUNDS.get(detail["type"], ("", ""))
    if word:
        return f"{word} {detail['ctx'][key]:g}"
    if known := _KINDS.get(detail["type"]):
        return known
    if detail["type"] == "value_error":
        return str(detail["ctx"]["error"])
    if detail["type"] in ("literal_error", "enum"):
        values = str(detail["ctx"]["expected"])
        return values + did_you_mean(str(detail["input"]), re.findall(r"'([^']+)'", values))
    return str(detail["msg"])


def _suggestion(location: tuple[int | str, ...]) -> str:
    section: type[BaseModel] = Campaign
    for part in location[:-1]:
        section = _TYPES.get(str(part)) or _step(section, part)
    known = list(section.model_fields)
    if location[:-1] == ("mechanism", "none") and (types := _types_with(str(location[-1]))):
        *first_types, last = types
        named = f"{', '.join(first_types)} or {last}" if first_types else last
        return f"type = {named} in [mechanism], which has this key; no type is given"
    close = difflib.get_close_matches(str(location[-1]), known, n=1)
    return f"a known key; did you mean {close[0]}?" if close else f"a known key, one of: {', '.join(known)}"


def _types_with(key: str) -> list[str]:
    """Types of [mechanism], in quotation marks, that have a key."""
    kinds = {tag: f'"{kind}"' for kind, tag in _TAGS.items()} | {"legged": '"6-pus"'}
    return [kinds[tag] for tag, section in _TYPES.items() if key in section.model_fields]


def _step(section: type[BaseModel], part: int | str) -> type[BaseModel]:
    """Model of a key; the same model for an index or a table's name."""
    field = section.model_fields.get(str(part))
    return section if field is None else _inner_model(field.annotation) or section


def _inner_model(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    arguments = getattr(annotation, "__args__", ())
    return next(
        (model_of_argument for argument in arguments if (model_of_argument := _inner_model(argument)) is not None), None
    )
