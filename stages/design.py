"""Choice of configurations that give the most information for a calibration, in order of measurement.

No stage of a run, because it comes before any measurement: tables in, a table and words out.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from truing.calibration.configuration_search import (
    AssessedConfigurations,
    assessed,
    bounded,
    choose,
    ordered,
    verification,
)
from truing.estimation.design.pose_selection import information_of
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.configurations.chosen import Design, DesignOptions, DesignTables
from truing.stages.configurations.needed import needed_by_models
from truing.stages.configurations.problem import design_problem, limits_of
from truing.stages.configurations.tables import configurations_table, existing_configurations, readings_of

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign


def design(settings: Campaign, options: DesignOptions, tables: DesignTables) -> Design:
    """Return configurations for a calibration and their efficiency; raises CampaignFaults."""
    limits = limits_of(
        settings, pose_too=options.within == "workspace", avoid=tables.avoid, avoid_file=tables.avoid_file
    )
    kept_rho = None if tables.extend is None else readings_of(tables.extend, limits.readings.size, tables.extend_file)
    if kept_rho is not None and not len(kept_rho):
        raise CampaignFaults([Fault(tables.extend_file, "poses to keep, that are not for verification")])
    measured = options.poses + (0 if kept_rho is None else len(kept_rho))
    with _fault_of(tables.avoid_file):
        problem = design_problem(settings, limits, options.parameters, tables.survey)
    if measured < len(problem.names):
        expected = f"at least {len(problem.names)} configurations, one for each parameter of a leg"
        raise CampaignFaults([Fault("--poses", expected, value=str(measured))])
    kept = None
    if kept_rho is not None:
        with _fault_of(tables.extend_file):
            kept = assessed(problem, kept_rho)
    rng, given = np.random.default_rng(options.seed), None if kept is None else kept.information
    with _fault_of(tables.avoid_file):
        candidates = bounded(problem, options.poses, given, rng)
    x = choose(problem, candidates, options.method, options.poses, given, rng)
    assessed_configurations = AssessedConfigurations(
        measured, information_of(problem.rows_at(x), given), 0 if kept is None else kept.outside
    )
    existing = existing_configurations(problem, tables.existing)
    with _fault_of("--verification", str(options.verification)):
        check = verification(problem, x, options.verification, rng)
    placed = problem.regressors.at(np.concatenate([x, check]))
    order = ordered(problem, placed, None if kept_rho is None else kept_rho[-1], rng, options.trade_off)
    # a new set begins at the reference unless it is forbidden
    is_new = tables.extend is None and bool(problem.region.allowed(np.zeros((1, 6)))[0])
    reference_rho = problem.regressors.machine.legs.rho0 if is_new else None
    table = configurations_table(placed.rho, order, reference_rho, options, tables.extend)
    needed = needed_by_models(settings, problem, rng)
    return Design(problem, options, placed, assessed_configurations, kept, existing, candidates, order, needed, table)


@contextmanager
def _fault_of(file: str, value: str | None = None) -> Iterator[None]:
    """Raise CampaignFaults for a ValueError with the expectation of a file or an option."""
    try:
        yield
    except ValueError as error:
        raise CampaignFaults([Fault(file, str(error), value=value)]) from None
