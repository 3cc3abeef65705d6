"""What readings, loads and the geometry of beams give to the entries of a compliance."""

from __future__ import annotations

import numpy as np

from truing.estimation.interferometry.loaded import Loaded, fitted_compliance
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.estimation.response_structure import birge
from truing.estimation.uncertainty_budget import Budget, Source, beyond_declared, budget, linear_estimate

BY_LOADS = Source("applied loads, as declared", "B")
GEOMETRY = Source("geometry of the beams", "B")


def compliance_budgets(loaded: Loaded, declared: bool) -> list[Budget] | None:
    """Return the budget of the entries (6,) of each of the six components; None where the readings leave some open.

    declared: whether the noise of readings was declared, and not found from their scatter. By the model in which every
    load may act on every component. Raises LinAlgError where a component is not determined by its own readings.
    """
    one = fitted_compliance(loaded, "matrix")
    if not one.known.all():
        return None
    ratio, dof = birge(one.fit), float(one.fit.dof)
    readings = Source("noise of the readings", "B") if declared else Source("noise of the readings", "A", dof)
    beyond = Source("scatter of the readings beyond that", "A", dof)
    rows = loaded.fitted
    found = []
    for k in range(len(CHANNELS)):
        own = rows & np.isfinite(loaded.reading[:, k])
        run = np.unique(loaded.steps.run[own], return_inverse=True)[1]
        columns = np.concatenate([loaded.steps.load[own], np.eye(run.max() + 1)[run]], 1)
        loads = np.full(own.sum(), loaded.by_loads[k])
        noise = {readings: loaded.variance[own, k] - loads, BY_LOADS: loads}
        sized = {source: ratio**2 * variance[:, None, None] for source, variance in noise.items()}
        parts = linear_estimate(columns[:, None], sized)
        total = np.zeros_like(parts[readings])
        for source in noise if ratio > 1.0 else ():
            split = beyond_declared({source: parts[source]}, source, ratio, beyond)
            parts[source], total = split[source], total + split[beyond]
        found.append(budget({**parts, beyond: total}, np.eye(len(LOADS), columns.shape[1])))
    return found


def budget_of_entries(found: list[Budget], loaded: Loaded, places: list[tuple[int, int]]) -> Budget:
    """Return the budgets of some entries (response, load) together, the geometry's part with them."""
    sources = tuple(dict.fromkeys(source for one in found for source in one.sources))
    table = np.zeros((len(sources), len(places)))
    for n, (i, j) in enumerate(places):
        for source, own in zip(found[i].sources, found[i].contributions, strict=True):
            table[sources.index(source), n] = own[j]
    return Budget(sources, table).beside(GEOMETRY, np.array([loaded.spread[place] for place in places])).filled()
