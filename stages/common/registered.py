"""Mechanisms that bring their own part of a stage: the module that does it, by the type of the mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign


def registered(modules: Mapping[str, str], settings: Campaign) -> Any:
    """Return the module that a stage lists for the campaign's type of mechanism; None where it lists none."""
    name = modules.get(settings.mechanism.type)
    return None if name is None else import_module(name)
