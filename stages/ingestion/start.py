"""The model of an earlier campaign of the same machine, which `[mechanism] model` names: copied, once it is one."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from truing.schemas.faults import Fault
from truing.schemas.settings_text import parsed_toml, read_settings_text

if TYPE_CHECKING:
    from truing.formats.faultlog import FaultLog
    from truing.formats.source import CampaignFiles

_COLUMN = "mechanism.model"
_WRITTEN = "a model.toml that a run has written"
# What the earlier run wrote of itself; the copy has a provenance of its own.
_PROVENANCE = re.compile(r"^\[provenance\].*?(?=^\[|\Z)", re.MULTILINE | re.DOTALL)


def read_start(source: CampaignFiles, settings: Any, log: FaultLog) -> str | None:
    """The earlier model as text; None where the campaign starts from none, or from what is at fault."""
    if settings.mechanism.type == "none" or settings.mechanism.model is None or source.earlier_model is None:
        return None
    try:
        text = read_settings_text(source.earlier_model.path)
        wrong = _departure(parsed_toml(text), settings.mechanism)
    except OSError:
        wrong = "a file that can be read: the model.toml of an earlier campaign"
    except (ValueError, RecursionError) as error:  # no text, no TOML, or numbers without end in it
        wrong = _WRITTEN if source.is_outside(source.earlier_model) else f"{_WRITTEN} ({error})"
    if wrong:
        log.add(Fault("campaign.toml", wrong, column=_COLUMN, value=source.earlier_model.name))
        return None
    return _PROVENANCE.sub("", text).rstrip("\n") + "\n"


def _departure(document: dict[str, Any], mechanism: Any) -> str:
    """What a parsed model would have to be instead; empty where it is one of this mechanism."""
    about, legs = document.get("model"), document.get("legs")
    if not isinstance(about, dict) or "covariance" not in document:
        return _WRITTEN
    of_sensor = about.get("mechanism") == "6-upur"
    if not (isinstance(document.get("compliance"), dict) if of_sensor else isinstance(legs, list)):
        return _WRITTEN
    if about.get("mechanism") != mechanism.type:
        return f"a model of a {mechanism.type}, not of a {about.get('mechanism')}"
    if isinstance(legs, list) and len(legs) != len(mechanism.legs):
        return f"a model of {len(mechanism.legs)} legs, not of {len(legs)}"
    return ""
