"""One effect hidden in one layout by `truing power` and by the independent generator; the same diagnosis of both is
compared."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from tests.blind.generator import effects as hidden
from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout
from tests.blind.generator.quaternions import Array
from tests.blind.generator.schedule import at_rest, random_moves
from tests.stages.line import run_line, settings_of
from truing.pipeline.campaign_folder import SettingsView
from truing.schemas.campaign import Campaign as Settings
from truing.simulation.cause import Effect
from truing.stages import pose
from truing.stages.diagnosis.search import assembled_data
from truing.stages.power import complete_plan
from truing.stages.simulated_campaigns.plan import CampaignPlan, bare_plan

_PLAN, _GENERATOR, _POWER = 0, 1, 2  # what is drawn from a seed, apart


@dataclass(frozen=True)
class Ground:
    """A layout in which targets, times and temperatures stay, while geometry and noise are drawn anew each time."""

    layout: Layout
    calibration: int
    verification: int
    seed: int

    def generated(self, effects: Sequence[hidden.Effect], *number: int) -> Campaign:
        """A campaign of the generator's."""
        rng = np.random.default_rng([self.seed, _GENERATOR, *number])
        return draw_campaign(self.layout, self._moves, effects, rng, np.random.default_rng([self.seed, _PLAN]))

    def power_tables(self, effects: Sequence[Effect], *number: int) -> dict[str, pa.Table]:
        """Tables of a campaign as `truing power` draws it, up to the poses."""
        tables = self.plan.drawn(effects, np.random.default_rng([self.seed, _POWER, *number]))
        view = SettingsView(self.settings, pose.DECLARATION.settings)
        return {**tables, **pose.run(tables, view, lambda *_: None).artifacts}

    def generated_tables(self, effects: Sequence[Effect], *number: int) -> dict[str, pa.Table]:
        """The same of the generator, which writes files."""
        return self._read(self.generated([as_hidden(effect, self.settings) for effect in effects], *number))[0]

    @property
    def settings(self) -> Settings:
        """Settings of campaign.toml."""
        return self._plain[1]

    @cached_property
    def plan(self) -> CampaignPlan:
        """The layout as `truing power` knows it, from a campaign in which nothing is hidden."""
        tables, settings = self._plain
        return complete_plan(bare_plan(tables, settings), assembled_data(tables, settings), tables["poses"])

    @cached_property
    def _moves(self) -> list[tuple[int, str, Array]]:
        moves = random_moves(self.calibration, self.verification, np.random.default_rng([self.seed, 3]))
        return [at_rest(), *moves]

    @cached_property
    def _plain(self) -> tuple[dict[str, pa.Table], Settings]:
        return self._read(self.generated([], 0))

    def _read(self, campaign: Campaign) -> tuple[dict[str, pa.Table], Settings]:
        with tempfile.TemporaryDirectory() as home:
            folder = write_campaign(campaign, Path(home) / "campaign", self.seed)
            return run_line(folder, "ingest", "pose")[0], settings_of(folder)


def as_hidden(effect: Effect, settings: Settings) -> hidden.Effect:
    """The generator's effect for one of the catalogue: what carries over is what the contract names of it."""
    count, cause = len(effect.values), effect.cause
    legs = len(settings.mechanism.legs)
    reported = {row.name: row.value for row in cause.reported(effect.values, np.zeros((count, count)), legs)}
    return _MAKERS[cause.id](reported, cause, legs)


def _per_leg(stated: Mapping[str, Any], name: str, legs: int) -> Array:
    return np.array([stated.get(f"{name}_{leg}", 0.0) for leg in range(1, legs + 1)])


def _grown(stated: Mapping[str, Any], legs: int) -> Array:
    return np.full(legs, stated["alpha"]) if "alpha" in stated else _per_leg(stated, "alpha", legs)


def _moved(stated: Mapping[str, Any], cause: Any, legs: int) -> hidden.Effect:
    shift = (stated["dx"], stated["dy"], stated["dz"])
    return hidden.TargetMoved(cause.body, cause.target, shift, stated["from_pose"])


_MAKERS: dict[str, Callable[[Mapping[str, Any], Any, int], hidden.Effect]] = {
    "actuator-gain": lambda stated, _, legs: hidden.ActuatorGain(_per_leg(stated, "gain", legs)),
    "actuator-backlash": lambda stated, _, legs: hidden.Backlash(_per_leg(stated, "backlash", legs)),
    "platform-deformation-linear": lambda stated, _, legs: hidden.LinearDeformation(_per_leg(stated, "kappa", legs)),
    "leg-drift": lambda stated, _, legs: hidden.LegDrift(_per_leg(stated, "drift", legs), stated.get("tau")),
    "leg-thermal": lambda stated, _, legs: hidden.LegThermal(_grown(stated, legs)),
    "measurement-scale": lambda stated, *_: hidden.MeasurementScale(
        stated.get("scale", 0.0), stated.get("scale_per_k", 0.0)
    ),
    "target-moved": _moved,
}
CAUSES = tuple(_MAKERS)
