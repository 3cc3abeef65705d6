"""Least number of configurations that each model of a machine needs for a calibration (telescope report, 6.3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.calibration.configuration_search import REPORTED, SEPARABLE
from truing.estimation.design.observability import choose_identifiable
from truing.simulation.mechanisms.parameters import SHARED, ParameterSet, full_set
from truing.simulation.mechanisms.pose_regressors import Placed
from truing.simulation.mechanisms.structures.structure import Machine, Structure, readings_at

# Singular values of separable parameters below this share of the largest are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class NeededConfigurations:
    """Least number of configurations of a model: names of its separable parameters, their number over all legs, and
    equations of each pose; shared: number of the parameters that belong to no leg."""

    model: str
    names: tuple[str, ...]
    parameters: int
    shared: int
    equations: int
    configurations: int


def needed_configurations(structure: Structure, machine: Machine, placed: Placed) -> NeededConfigurations | None:
    """Return the least number of generic poses that determine the parameters separable by all configurations (B).

    The last configurations count as generic. None where the model does not reach the poses.
    """
    parameters = model_set(structure, machine)
    readings = readings_at(structure, machine, placed.p, placed.R)
    if not readings.converged.all():
        return None
    rows = structure.close(machine, placed.p, placed.R, readings.rho, parameters.change(machine)).by_parameter
    size = np.sqrt(np.sum(rows**2, (0, 1)))
    rows = rows / np.where(size > 0.0, size, 1.0)
    names = [entry.name for entry in parameters.entries]
    chosen = _separable(rows.reshape(-1, len(names)), parameters)
    rows_last_first, equations = rows[::-1, :, chosen], rows.shape[1]
    least = -(-len(chosen) // equations)
    count = next((n for n in range(least, len(rows)) if _rank(rows_last_first[:n]) == len(chosen)), len(rows))
    columns = tuple(dict.fromkeys(names[k] for k in chosen))
    shared = sum(parameters.entries[k].leg == SHARED for k in chosen)
    return NeededConfigurations(structure.name, columns, len(chosen), shared, equations, count)


def model_set(structure: Structure, machine: Machine) -> ParameterSet:
    """Return all parameters of a model whose platform is rigid."""
    beam, elastic = structure.name == "beam", structure.name == "stiffness"
    return full_set(machine, "none", flexure_length=beam, sections=elastic)


def _separable(rows: NDArray, parameters: ParameterSet) -> NDArray:
    """Return the indices of a maximal separable set, the same for every leg."""
    names = [entry.name for entry in parameters.entries]
    groups = [list(dict.fromkeys(names)).index(name) for name in names]
    first = [0.0 if name in REPORTED else 1.0 for name in names]
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    chosen_set = choose_identifiable(
        triangle,
        np.ones(len(names)),
        list(parameters.labels),
        groups=groups,
        preference=first,
        unidentifiable=1.0 / SEPARABLE,
    )
    return np.flatnonzero(chosen_set.chosen)


def _rank(rows: NDArray) -> int:
    values = np.linalg.svd(rows.reshape(-1, rows.shape[-1]), compute_uv=False)
    return int(np.sum(values > _ROUNDING * values[0]))
