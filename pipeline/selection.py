"""Which stages a call asks for, and which of them run even where they are fresh."""

from __future__ import annotations

from dataclasses import dataclass

from truing.pipeline.stage_order import needed_for
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.near_names import meant
from truing.stages.declaration import Stage


@dataclass(frozen=True)
class Selection:
    """``first``: rerun from this stage on; ``only``: this stage and what it needs; ``force``: run what is fresh too."""

    first: str | None = None
    only: str | None = None
    force: bool = False

    def stages(self, order: tuple[Stage, ...]) -> tuple[Stage, ...]:
        """The stages concerned, in order; raises CampaignFaults where a stage is named that this campaign lacks."""
        names = [stage.name for stage in order]
        for option, name in (("--from", self.first), ("--only", self.only)):
            if name is not None and name not in names:
                raise CampaignFaults([Fault(option, _expected(name, names), value=name)])
        return order if self.only is None else needed_for(self.only, order)

    def forces(self, stage: Stage, order: tuple[Stage, ...]) -> bool:
        """Whether a stage shall run although it is fresh."""
        if self.only is not None:
            return self.force and stage.name == self.only
        names = [each.name for each in order]
        return self.force or (self.first is not None and names.index(stage.name) >= names.index(self.first))


def _expected(name: str, names: list[str]) -> str:
    return f"a stage of this kind of campaign ({', '.join(names)}){meant(name, names)}"
