"""What campaign.toml may hold, key by key; anything else is a fault with a suggestion."""

from __future__ import annotations

import difflib
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, Discriminator, Field, Tag, ValidationError, model_validator

from schemas.certificate import Certificate
from schemas.faults import CampaignFaults, Fault
from schemas.interferometer import Interferometer
from schemas.mapping import FileMapping
from schemas.mechanism import LeggedMechanism, NoMechanism
from schemas.photographs import GivenCamera, Photographs
from schemas.quality_checks import limit_faults
from schemas.section import Section
from schemas.sections import (
    Acceptance,
    Bodies,
    CampaignSection,
    Diagnosis,
    Loading,
    Noise,
    Overrule,
    QualityLimits,
    Renamed,
    Requirement,
    Resurvey,
    Signals,
    Workspace,
)
from schemas.sensor_mechanism import SensorMechanism


def _tag(section: Any) -> str:
    kind = section.get("type", "none") if isinstance(section, dict) else getattr(section, "type", "none")
    return kind if kind in ("none", "6-upur") else "legged"


Mechanism = Annotated[
    Annotated[LeggedMechanism, Tag("legged")]
    | Annotated[SensorMechanism, Tag("6-upur")]
    | Annotated[NoMechanism, Tag("none")],
    Discriminator(_tag),
]


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
    photographs: Photographs = Photographs()
    cameras: tuple[GivenCamera, ...] = ()
    workspace: Workspace = Workspace()
    requirement: Requirement = Requirement()
    noise: Noise = Noise()
    bodies: Bodies = Bodies()
    diagnosis: Diagnosis = Diagnosis()
    qa: QualityLimits = QualityLimits()
    exclude: tuple[Overrule, ...] = ()
    keep: tuple[Overrule, ...] = ()
    accept: tuple[Acceptance, ...] = ()
    renamed: tuple[Renamed, ...] = ()
    resurvey: tuple[Resurvey, ...] = ()
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
                    "pose, body or target in [[exclude]] and [[keep]]: run, step and channel are a bench's"
                )
        elif self.renamed or self.resurvey:
            raise ValueError("no [[renamed]] and no [[resurvey]]: a bench has no targets")
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
        campaign = Campaign.model_validate(document)
    except ValidationError as error:
        raise CampaignFaults(_fault(file, detail) for detail in error.errors()) from None
    if faults := tuple(limit_faults(file, campaign.campaign.kind, campaign.qa.limits)):
        raise CampaignFaults(faults)
    return campaign


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
