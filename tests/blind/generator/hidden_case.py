"""A planned campaign with hidden effects, and the same without them; shared by both generators."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from tests.blind.generator.folder import truth_path
from tests.blind.generator.named_effect import NamedEffect

NEAR = 0.01  # a strength is met to this share
ROUNDS = 12


class Planned(Protocol):
    """Everything about a campaign but the effects."""

    kind: str
    layout: Any
    seed: int

    def campaign(self, effects: Sequence[Any] = (), *, exact: bool = False) -> Any: ...


@dataclass(frozen=True)
class HiddenCase(ABC):
    """A campaign with effects in it, each as strong alone as stated (inf where size is not to be chosen)."""

    plan: Planned
    effects: tuple[NamedEffect, ...]
    strengths: tuple[float, ...]

    @abstractmethod
    def put(self, campaign: Any, folder: Path) -> None:
        """Writes a campaign."""

    @property
    def reported(self) -> Mapping[str, object]:
        """Facts of the plan in the file of the truth."""
        return {"layout": self.plan.kind}

    def write(self, folder: Path) -> Path:
        """Writes the campaign under the folder's name, and its truth next to it."""
        plan = replace(self.plan, layout=replace(self.plan.layout, name=folder.name))
        self.put(plan.campaign(self.effects), folder)
        truth = json.loads(truth_path(folder).read_text(encoding="utf-8"))
        truth |= {**self.reported, "strengths": [round(value, 3) for value in self.strengths]}
        truth_path(folder).write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
        return folder


@dataclass(frozen=True)
class PlannedMeasure(ABC):
    """Measures how strongly effects show in a planned campaign."""

    plan: Planned

    @cached_property
    def plain(self) -> Any:
        """The campaign with nothing hidden in it."""
        return self.plan.campaign()

    @cached_property
    def exact(self) -> Any:
        """The same without any noise."""
        return self.plan.campaign(exact=True)

    @abstractmethod
    def strength(self, effect: Any) -> float:
        """Root of the effect's non-centrality after all that a fit does not know."""

    def sized(self, of_size: Callable[[float], Any], wanted: float, size: float) -> tuple[Any, float, float]:
        """The effect of the size at which it is as strong as wanted, its strength, and that size, from a first one."""
        for _ in range(ROUNDS):
            effect = of_size(size)
            found = self.strength(effect)
            if abs(found / wanted - 1) < NEAR or found == 0.0:
                break
            size *= wanted / found
        return effect, found, size
