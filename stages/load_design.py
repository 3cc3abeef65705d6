"""Choice of load steps that give the most information for a sensor's calibration.

Not a stage of a run: `truing design` calls it with a campaign.toml, and gets a table and sentences.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array
from truing.estimation.design.pose_order import order_poses
from truing.estimation.sensor.load_cases import (
    LoadDesign,
    LoadLimits,
    bench_loads,
    choose_loads,
    corner_loads,
    load_efficiency,
    load_rows,
    predicted_sigma,
    verification_loads,
)
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.common.nominal_mechanism import FILE
from truing.stages.common.reading_arrays import LOAD_COLUMNS, load_steps
from truing.stages.configurations.chosen import DesignOptions, LoadPlan
from truing.stages.configurations.tables import loads_table

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

_FULL = np.array([1.0])


def plan_loads(settings: Campaign, options: DesignOptions, tables: Mapping[str, pa.Table]) -> LoadPlan:
    """Choose load steps within [loading], at most ``options.at_once`` components at a time; raises CampaignFaults.

    tables: readings and signals of the campaign, with which the choice is compared.
    """
    limits = LoadLimits(_limits(settings))
    rng = np.random.default_rng(options.seed)
    candidates = corner_loads(limits) if options.may_all_act else bench_loads(limits, _FULL, options.at_once)
    try:
        chosen = choose_loads(candidates, options.poses, limits, rng=rng)
    except ValueError as error:
        raise CampaignFaults([Fault("--poses", str(error), value=str(options.poses))]) from None
    regressors = np.stack([load_rows(chosen.loads, limits, zero=False, powers="linear")[:, 0]])
    order = order_poses(chosen.loads / limits.limits, np.zeros(len(LOAD_COLUMNS)), regressors, rng, options.trade_off)
    sigma = predicted_sigma(chosen.loads, np.ones(1), limits)[0] * limits.limits
    table = loads_table(
        chosen.loads[order.order], verification_loads(limits, options.verification, options.at_once, rng)
    )
    existing = _existing(tables, limits)
    return LoadPlan(options, limits, chosen, len(candidates), order, sigma, existing, settings.noise.signal_mv, table)


def _limits(settings: Campaign) -> Array:
    missing = [name for name in LOAD_COLUMNS if getattr(settings.loading, name) is None]
    if missing:
        expected = "the range of this load, within which to choose"
        raise CampaignFaults(Fault(FILE, expected, column=f"loading.{name}") for name in missing)
    return np.array([getattr(settings.loading, name) for name in LOAD_COLUMNS])


def _existing(tables: Mapping[str, pa.Table], limits: LoadLimits) -> LoadDesign | None:
    """The campaign's own calibration loads; the loads they are compared with may act on all axes at once."""
    existing = {name: table for name, table in tables.items() if name in ("signals", "readings")}
    if not existing:
        return None
    steps = load_steps({"signals": existing["signals"]} if "signals" in existing else existing)
    loads = steps.load[~steps.held_out]
    return load_efficiency(loads, corner_loads(limits), limits) if len(loads) else None
