"""Base of every hidden effect: id, sizes and subject, and their form in the file of truths."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import ClassVar

from tests.blind.generator.quaternions import Array

Parameter = tuple[float | str | None, str]  # value, unit


class NamedEffect:
    """An effect as it is reported."""

    id: ClassVar[str]

    def parameters(self) -> Mapping[str, Parameter]:
        """Name to value and unit, named as in the campaign format."""
        raise NotImplementedError

    @property
    def subject(self) -> str:
        """Subject of the effect, empty for the whole."""
        return ""

    @property
    def drivers(self) -> tuple[str, ...]:
        """Columns that it follows, of an effect that is in no catalogue and known by these alone."""
        return ()

    def scatter(self, scatter: Array, setting: object) -> Array:
        """Scatter of each point (N, M) or reading (S, 6), relative to the instrument's noise."""
        return scatter


def as_record(effect: NamedEffect) -> dict[str, object]:
    """Record of the effect in the file of truths."""
    values = {name: {"value": value, "unit": unit} for name, (value, unit) in effect.parameters().items()}
    reported = {"cause": effect.id, "subject": effect.subject, "parameters": values}
    if effect.id == "unexplained":
        reported |= {"kind": type(effect).__name__, "follows": " ".join(effect.drivers)}
    return json.loads(json.dumps(reported))
