"""Detectable effects of a campaign's layout, by diagnosis of simulated campaigns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from truing.inference.detectable import EffectSensitivity, effect_sensitivities
from truing.simulation.cause import Cause

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.selection import Settings
    from truing.schemas.campaign import Campaign
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData
    from truing.stages.simulated_campaigns.plan import CampaignPlan, RayPlan, ReadingPlan

    Plan = CampaignPlan | ReadingPlan | RayPlan

# Simulated residuals behind theory's threshold: that of a diagnosis, from its 400, scatters from campaign to campaign.
_THRESHOLD_DRAWS = 1600


def searched_causes(plan: Plan, settings: Campaign) -> tuple[Mapping[str, Cause], Settings]:
    """The causes that a diagnosis of such a campaign looks for, by id, and how sure it must be."""
    from truing.simulation.catalogue import catalogue_of_rays
    from truing.stages.diagnosis.search import kinds_of, rule_of, rule_of_rays, searched_for
    from truing.stages.simulated_campaigns.plan import RayPlan

    rule = rule_of(settings)
    kinds, own = (catalogue_of_rays(), rule_of_rays(rule)) if isinstance(plan, RayPlan) else (kinds_of(settings), rule)
    return {cause.id: cause for cause in searched_for(settings, kinds.values())}, own


def compared(plan: Plan, tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData:
    """What a diagnosis compares of a drawn campaign; raises ValueError, saying why, where the tables do not hold it."""
    from truing.stages.diagnosis.ray_points import assemble_rays
    from truing.stages.diagnosis.search import assembled_data
    from truing.stages.simulated_campaigns.plan import RayPlan

    return assemble_rays(tables, settings)[0] if isinstance(plan, RayPlan) else assembled_data(tables, settings)


def expected_sights(plan: Plan, data: DiagnosisData, settings: Campaign) -> list[EffectSensitivity]:
    """How well the search sees each sort of effect in a drawn campaign without any."""
    from truing.inference.fitted_model import Fitter
    from truing.inference.search import search_of

    kinds, rule = searched_causes(plan, settings)
    fitter = Fitter(data.model, data.calibration, data.held_out, settings.diagnosis.seed)
    fitted = fitter.prepared()
    rng = np.random.default_rng(settings.diagnosis.seed)
    return effect_sensitivities(search_of(fitted, list(kinds.values()), _THRESHOLD_DRAWS, rng), rule.level)


def completed(bare: CampaignPlan, data: DiagnosisData, poses: pa.Table) -> CampaignPlan:
    """A plan with all that the diagnosis knows of the campaign: tolerances, and how legs' targets sit on them."""
    from truing.stages.simulated_campaigns.plan import full_plan

    return full_plan(bare, data.model, data.calibration.measured.seen, poses)


def reading_plan_of(tables: Mapping[str, pa.Table], settings: Campaign) -> ReadingPlan:
    """The plan of a loading campaign; raises ValueError, saying why, where it cannot be simulated."""
    from truing.stages.diagnosis.reading_points import reading_model
    from truing.stages.simulated_campaigns.plan import reading_plan

    return reading_plan(tables, reading_model(tables, settings))


def ray_plan_of(tables: Mapping[str, pa.Table], settings: Campaign) -> RayPlan:
    """The plan of a run's rays; raises ValueError, saying why, where they cannot be held against each other."""
    from truing.stages.diagnosis.ray_points import assemble_rays, has_rays
    from truing.stages.simulated_campaigns.plan import ray_plan

    if not has_rays(tables):
        raise ValueError("needs rays of three poses or more")
    data, whole = assemble_rays(tables, settings)
    return ray_plan(tables, whole, data.model.scene)
