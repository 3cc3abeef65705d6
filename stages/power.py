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
    from truing.stages.simulated_campaigns.axis_plan import AxisPlan
    from truing.stages.simulated_campaigns.chain_plan import ChainPlan
    from truing.stages.simulated_campaigns.plan import CampaignPlan, RayPlan, ReadingPlan

    Plan = CampaignPlan | ReadingPlan | RayPlan | ChainPlan | AxisPlan

# Simulated residuals behind theory's threshold: that of a diagnosis, from its 400, scatters from campaign to campaign.
_THRESHOLD_DRAWS = 1600


def searched_causes(plan: Plan, settings: Campaign) -> tuple[Mapping[str, Cause], Settings]:
    """Return the causes that the diagnosis of such a campaign searches for, by id, and its required certainty."""
    from truing.simulation.catalogue import catalogue_of_rays
    from truing.stages.diagnosis.search import kinds_of, rule_of, rule_of_rays, searched_for
    from truing.stages.simulated_campaigns.plan import RayPlan

    rule = rule_of(settings)
    kinds, rule_of_plan = (
        (catalogue_of_rays(), rule_of_rays(rule)) if isinstance(plan, RayPlan) else (kinds_of(settings), rule)
    )
    return {cause.id: cause for cause in searched_for(settings, kinds.values())}, rule_of_plan


def diagnosis_data_of(plan: Plan, tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData:
    """Return the data that a diagnosis of a drawn campaign compares; raises ValueError with the reason if its tables
    are insufficient."""
    from truing.stages.diagnosis.ray_points import assemble_rays
    from truing.stages.diagnosis.search import assembled_data
    from truing.stages.simulated_campaigns.plan import RayPlan

    return assemble_rays(tables, settings)[0] if isinstance(plan, RayPlan) else assembled_data(tables, settings)


def expected_sights(plan: Plan, data: DiagnosisData, settings: Campaign) -> list[EffectSensitivity]:
    """Yield the expected detectability of each kind of effect in a drawn campaign without effects."""
    from truing.inference.fitter import Fitter
    from truing.inference.search_candidates import search_of

    kinds, rule = searched_causes(plan, settings)
    fitter = Fitter(data.model, data.calibration, data.held_out, settings.diagnosis.seed)
    fitted = fitter.prepared()
    rng = np.random.default_rng(settings.diagnosis.seed)
    return effect_sensitivities(search_of(fitted, list(kinds.values()), _THRESHOLD_DRAWS, rng), rule.level)


def complete_plan(bare: CampaignPlan, data: DiagnosisData, poses: pa.Table) -> CampaignPlan:
    """Return the plan with the prior knowledge of the diagnosis: tolerances, and positions of targets on legs."""
    from truing.stages.simulated_campaigns.plan import full_plan

    return full_plan(bare, data.model, data.calibration.measured.is_observed, poses)


def reading_plan_of(tables: Mapping[str, pa.Table], settings: Campaign) -> ReadingPlan:
    """Return the plan of a loading campaign; raises ValueError with the reason if it cannot be simulated."""
    from truing.stages.diagnosis.reading_points import reading_model
    from truing.stages.simulated_campaigns.plan import reading_plan

    return reading_plan(tables, reading_model(tables, settings))


def chain_plan_of(tables: Mapping[str, pa.Table], settings: Campaign) -> ChainPlan:
    """Return the plan of a campaign of a chain, measured or planned; raises ValueError with the reason if it cannot be
    simulated."""
    from truing.stages.common.chain_tables import tree_of
    from truing.stages.diagnosis.search import assembled_data
    from truing.stages.simulated_campaigns.chain_plan import chain_plan, nominal_tables

    if not any(name in tables and tables[name].num_rows for name in ("observations", "measured_poses", "distances")):
        tree = tree_of(tables["joints"])
        tables = nominal_tables(tree, tables["joints"], tables.get("survey"), tables["configurations"], settings)
    data = assembled_data(tables, settings).whole
    return chain_plan(tables, data.model, [data.calibration, *filter(None, [data.held_out])])


def axis_plan_of(tables: Mapping[str, pa.Table], settings: Campaign) -> AxisPlan:
    """Return the plan of a campaign of an axis, measured or planned; raises ValueError with the reason if it cannot be
    simulated."""
    from truing.stages.common.axis_columns import columns_of, command_sigma, encoder_sigma
    from truing.stages.diagnosis.search import assembled_data
    from truing.stages.simulated_campaigns.axis_plan import axis_plan

    columns = columns_of(settings, tables["configurations"])
    sigma = np.array([encoder_sigma(settings, name) for name in columns.encoders], float)
    model = assembled_data(tables, settings).model
    return axis_plan(tables, model, columns, sigma, command_sigma(settings))


def ray_plan_of(tables: Mapping[str, pa.Table], settings: Campaign) -> RayPlan:
    """Return the plan of a run's rays; raises ValueError with the reason if they cannot be compared."""
    from truing.stages.diagnosis.ray_points import assemble_rays, has_rays
    from truing.stages.simulated_campaigns.plan import ray_plan

    if not has_rays(tables):
        raise ValueError("needs rays of three poses or more")
    data, dataset = assemble_rays(tables, settings)
    return ray_plan(tables, dataset, data.model.scene)
