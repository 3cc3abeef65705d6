"""Effects of `truing power` are as strong as those of the independent generator in the same layout.

The signal-to-noise ratio of the hidden cause's own candidate is compared, which tells more per campaign than whether it
was found: the power of the diagnosis follows from it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import ActuatorGain as HiddenGain
from tests.blind.generator.effects import LinearDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Noise, Targets
from tests.blind.generator.schedule import at_rest, random_moves
from tests.stages.line import run_line, settings_of
from truing.inference.fitter import Fitter
from truing.inference.rounds import score_round
from truing.pipeline.campaign_folder import SettingsView
from truing.schemas.campaign import Campaign
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.causes.deformation import LinearPlatformDeformation
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.stages import pose
from truing.stages.diagnosis.search import assembled_data
from truing.stages.power import complete_plan
from truing.stages.simulated_campaigns.plan import CampaignPlan, bare_plan

CAMPAIGNS = 4
LAYOUT = Layout(
    "small", targets=Targets(base=5, platform=4, per_leg=0), noise=Noise(point_mm=0.006), faults=DataFaults(0.0, 0.0)
)
MOVES = [at_rest(), *random_moves(14, 2, np.random.default_rng(1))]
PATTERN = np.array([1.0, -0.6, 0.4, 1.2, -1.1, 0.3])
HIDDEN: dict[str, tuple[Any, Any, float]] = {
    "gain": (HiddenGain, ActuatorGain(), 0.006),
    "linear": (LinearDeformation, LinearPlatformDeformation(), 0.006),
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("agreement")


@pytest.fixture(scope="module")
def plan(folders: Path) -> tuple[CampaignPlan, Campaign]:
    folder = write_campaign(draw_campaign(LAYOUT, MOVES, [], np.random.default_rng(2)), folders / "plain", 2)
    tables, settings = run_line(folder, "ingest", "pose")[0], settings_of(folder)
    return complete_plan(bare_plan(tables, settings), assembled_data(tables, settings), tables["poses"]), settings


def _signal(tables: dict[str, pa.Table], settings: Campaign, cause: Any) -> float:
    gathered = assembled_data(tables, settings)
    stand = Fitter(gathered.model, gathered.calibration, None, 0).prepared()
    return score_round(stand, [cause], 50, np.random.default_rng(0)).scores[cause.key].signal_to_noise


def _generated(folders: Path, name: str, settings: Campaign) -> list[float]:
    effect, cause, size = HIDDEN[name]
    found = []
    for number in range(CAMPAIGNS):
        campaign = draw_campaign(LAYOUT, MOVES, [effect(size * PATTERN)], np.random.default_rng([3, number]))
        folder = write_campaign(campaign, folders / f"{name}-{number}", number)
        found.append(_signal(run_line(folder, "ingest", "pose")[0], settings, cause))
    return found


def _drawn(plan: CampaignPlan, name: str, settings: Campaign) -> list[float]:
    _, cause, size = HIDDEN[name]
    view = SettingsView(settings, pose.DECLARATION.settings)
    found = []
    for number in range(CAMPAIGNS):
        tables = plan.drawn((Effect(cause, size * PATTERN),), np.random.default_rng([4, number]))
        found.append(_signal({**tables, **pose.run(tables, view, lambda *_: None).artifacts}, settings, cause))
    return found


@pytest.mark.parametrize("name", HIDDEN)
def test_both_generators_give_an_effect_the_same_signal_strength(
    name: str, plan: tuple[CampaignPlan, Campaign], folders: Path
) -> None:
    ours, theirs = _drawn(plan[0], name, plan[1]), _generated(folders, name, plan[1])
    assert min(*ours, *theirs) > 6.0, "an effect that is seen"
    scatter = np.sqrt((np.var(ours, ddof=1) + np.var(theirs, ddof=1)) / CAMPAIGNS)
    least = np.sqrt(2.0 / CAMPAIGNS)  # unit noise along the effect
    assert abs(np.mean(ours) - np.mean(theirs)) < 4.0 * max(scatter, least)
    assert 0.2 < np.std(ours, ddof=1) / np.std(theirs, ddof=1) < 5.0
