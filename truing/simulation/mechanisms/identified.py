"""What a fit of points says of the machine's own numbers, under the names of the tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.model import PointModel
from truing.simulation.mechanisms.parameters import Parameter, ParameterSet, full_set
from truing.simulation.mechanisms.structures.structure import Machine

_TINY = 1e-30


@dataclass(frozen=True)
class IdentifiedGeometry:
    """P numbers of the geometry, SI: nominal and identified (P,), covariance and prior covariance (P, P).

    known (P,): whose prior is a tolerance, and not merely wide. by_shared (P, G): how they follow the model's unknowns.
    """

    parameters: tuple[Parameter, ...]
    nominal: NDArray
    values: NDArray
    covariance: NDArray
    prior: NDArray
    known: NDArray
    by_shared: NDArray

    @property
    def sigma(self) -> NDArray:
        """Return the standard deviations (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def tolerance(self) -> NDArray:
        """Return one sigma (P,) of manufacturing and assembly; NaN where nothing is known."""
        return np.where(self.known, np.sqrt(np.diag(self.prior)), np.nan)


def identified_geometry(model: PointModel, shared: NDArray, covariance: NDArray) -> IdentifiedGeometry:
    """Return the geometry at shared unknowns (G,) with covariance (G, G); derivatives by complex step, exact."""
    every = full_set(_machine(model.nominal), "none").entries
    entries = ParameterSet(tuple(entry for entry in every if _part(entry) in model.layout))
    by_shared = np.zeros((len(entries), model.shared_size))
    for name in ("a", "b", "u", "l"):
        for i in range(*model.layout.get(name, slice(0)).indices(model.shared_size)):
            nudged = shared + 1j * _TINY * (np.arange(len(shared)) == i)
            by_shared[:, i] = _values(entries, model.legs(nudged)).imag / _TINY
    return IdentifiedGeometry(
        entries.entries,
        _values(entries, model.nominal),
        _values(entries, model.legs(shared)),
        by_shared @ covariance @ by_shared.T,
        by_shared @ by_shared.T,
        np.array([_part(entry) not in model.known.open_geometry for entry in entries.entries], bool),
        by_shared,
    )


def _part(entry: Parameter) -> str:
    return entry.name.partition("_")[0]


def _machine(legs: Legs) -> Machine:
    return Machine(legs, np.zeros((legs.count, legs.count)), None, None, None)


def _values(entries: ParameterSet, legs: Legs) -> NDArray:
    return entries.values(_machine(legs)) if len(entries) else np.zeros(0)


def name_and_leg(name: str) -> tuple[str, int | None]:
    """Return the name of an effect's parameter and its leg: ``gain_3`` is leg 3's gain, ``K12`` of leg 1 stays K12."""
    head, _, leg = name.rpartition("_")
    if head and leg.isdigit() and not head.startswith("K"):
        return head, int(leg)
    if name.startswith("K") and name[1:].replace("_", "").isdigit():
        return name, int(head[1:] if head else name[1])
    return name, None
