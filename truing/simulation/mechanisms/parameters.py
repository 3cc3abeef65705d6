"""Class `ParameterSet`: named parameters of a machine to identify, and the machine as a function of them.

Names are those of the tables: a_x .. b_z, u_x .. u_z, l, rho0, kappa (the leg's own entry of K), K11 .. (a leg's row of
K), Kx11 .., Ky11 .. (the same of its shift along x and y of the platform), flexure_length, beta; shared by all legs
flexure_bending, flexure_axial, flexure_torsion and the same of tube.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.structures.structure import BeamSection, Machine

_OF_LEGS = ("a", "b", "u", "l", "rho0")
_AXES = ("x", "y", "z")
_STIFFNESS = {"bending": "N m2", "axial": "N", "torsion": "N m2"}
SHARED = -1


@dataclass(frozen=True)
class LegParameter:
    """Parameter of one leg (from 0; -1: shared by all), with its unit in the tables and the SI value of one unit."""

    name: str
    leg: int
    unit: str
    si: float

    @property
    def label(self) -> str:
        """Name with the leg's number, from 1: a_x3; K14 already contains the leg."""
        is_whole = self.leg == SHARED or self.name.startswith("K")
        return self.name if is_whole else f"{self.name}{self.leg + 1}"

    @property
    def leg_number(self) -> int | None:
        """Leg counted from 1, as in tables; None if legs share the parameter."""
        return None if self.leg == SHARED else self.leg + 1


@dataclass(frozen=True)
class _Slot:
    """Position of a parameter in a machine: field, and index within it."""

    field: str
    place: tuple[int, ...]


@dataclass(frozen=True)
class ParameterSet:
    """Ordered parameters; values (..., P) in SI; leading batch axes carry over to the machine's arrays."""

    entries: tuple[LegParameter, ...]

    def __len__(self) -> int:
        return len(self.entries)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names with legs."""
        return tuple(entry.label for entry in self.entries)

    @property
    def units(self) -> NDArray:
        """SI value of one unit of the tables, (P,)."""
        return np.array([entry.si for entry in self.entries])

    @cached_property
    def _slots(self) -> dict[str, tuple[NDArray, tuple[Any, ...]]]:
        """Positions among the parameters, and indices into the array, by field."""
        slots = [_slot(entry) for entry in self.entries]
        slot_of: dict[str, tuple[NDArray, tuple[Any, ...]]] = {}
        for field in dict.fromkeys(slot.field for slot in slots):
            chosen = [i for i, slot in enumerate(slots) if slot.field == field]
            indices = np.array([slots[i].place for i in chosen])
            slot_of[field] = np.array(chosen), tuple(indices.T)
        return slot_of

    def values(self, machine: Machine) -> NDArray:
        """Return the values (..., P) of the parameters in a machine."""
        parts = {field: _array(machine, field) for field in self._slots}
        batch = np.broadcast_shapes(*(part.shape[: part.ndim - _RANK[name]] for name, part in parts.items()))
        values = np.zeros((*batch, len(self)), np.result_type(float, *parts.values()))
        for field, (chosen, index) in self._slots.items():
            values[..., chosen] = parts[field][..., *index]
        return values

    def machine(self, nominal: Machine, values: NDArray) -> Machine:
        """Return the nominal machine with these values (..., P); directions u keep unit length, or become NaN.

        Raises ValueError if the parameters contain the largest component of u, which follows from the others.
        """
        arrays = {}
        for field, (chosen, index) in self._slots.items():
            start = _array(nominal, field)
            array = np.broadcast_to(start, (*values.shape[:-1], *start.shape[-_RANK[field] :]))
            array = array.astype(np.result_type(start, values))
            array[..., *index] = values[..., chosen]
            arrays[field] = self._normalised(array, start) if field == "u" else array
        return _with_arrays(nominal, arrays)

    def change(self, machine: Machine) -> Change:
        """Return the derivative of the machine's fields by the parameters."""
        fields = {}
        for field, (chosen, index) in self._slots.items():
            array = _array(machine, field)
            batch = array.shape[: array.ndim - _RANK[field]] if field == "u" else ()
            slope = np.zeros((*batch, *array.shape[-_RANK[field] :], len(self)), array.dtype)
            slope[..., *index, chosen] = 1.0
            fields[field] = _tangent_to_sphere(array, slope) if field == "u" else slope
        return Change(fields, len(self))

    def _normalised(self, u: NDArray, nominal: NDArray) -> NDArray:
        """Return directions of unit length by adjusting the component that is largest in the nominal ones."""
        largest = np.argmax(np.abs(nominal), -1)[..., None]
        leg, axis = self._slots["u"][1]
        if np.any(largest[..., leg, 0] == axis):
            raise ValueError("u: found the largest component of u as a parameter, expected the two smallest")
        np.put_along_axis(u, np.broadcast_to(largest, (*u.shape[:-1], 1)), 0.0, -1)
        square = 1.0 - np.sum(u * u, -1, keepdims=True)
        largest_component = np.sqrt(np.where(square.real < 0.0, np.nan, square))
        sign = np.sign(np.take_along_axis(nominal, largest, -1).real)
        np.put_along_axis(u, np.broadcast_to(largest, (*u.shape[:-1], 1)), sign * largest_component, -1)
        return u


def _tangent_to_sphere(u: NDArray, slope: NDArray) -> NDArray:
    """Add the derivative of the largest component to those of the other two: du_z = -(u_x du_x + u_y du_y) / u_z."""
    largest = np.argmax(np.abs(u), -1)[..., None]
    follows = -np.sum(u[..., None] * slope, -2, keepdims=True) / np.take_along_axis(u, largest, -1)[..., None]
    return slope + np.where((np.arange(3) == largest)[..., None], follows, 0.0)


# Number of trailing axes of each field of a machine that may contain parameters.
_RANK = {"a": 2, "b": 2, "u": 2, "l": 1, "rho0": 1, "deformation": 2, "flexure_length": 1, "flexure": 1, "tube": 1}
_RANK |= {"in_plane": 3, "beta": 1}
_IN_PLANE = ("Kx", "Ky")


def _slot(parameter: LegParameter) -> _Slot:
    """Return the position of a parameter; raises ValueError for a name that no machine has."""
    name, leg = parameter.name, parameter.leg
    head, _, tail = name.partition("_")
    if head in ("a", "b", "u") and tail in _AXES:
        return _Slot(head, (leg, _AXES.index(tail)))
    if name in ("l", "rho0", "flexure_length", "beta"):
        return _Slot(name, (leg,))
    if name == "kappa":
        return _Slot("deformation", (leg, leg))
    if is_in_plane(parameter):
        return _Slot("in_plane", (leg, _IN_PLANE.index(name[:2]), column_of(parameter)))
    if name.startswith("K") and name[1:].replace("_", "").isdigit():
        return _Slot("deformation", (leg, column_of(parameter)))
    if head in ("flexure", "tube") and tail in _STIFFNESS:
        return _Slot(head, (list(_STIFFNESS).index(tail),))
    raise ValueError(f"parameter: found {name!r}, expected a number of the machine")


def is_in_plane(parameter: LegParameter) -> bool:
    """Return True for coefficients of shifts in the platform's plane."""
    return parameter.name[:2] in _IN_PLANE


def column_of(parameter: LegParameter) -> int:
    """Return j - 1 of the name Kij, Ki_j, Kxij or Kxi_j of leg i."""
    digits = parameter.name.lstrip("Kxy")
    return int(digits.partition("_")[2] if "_" in digits else digits[len(str(parameter.leg + 1)) :]) - 1


def _array(machine: Machine, field: str) -> NDArray:
    """Return a field of the machine; raises ValueError if the machine lacks it."""
    value = getattr(machine.legs if field in _OF_LEGS else machine, field)
    if value is None:
        raise ValueError(f"machine: found no {field}, expected values for its parameters")
    return (
        np.stack([value.bending, value.axial, value.torsion], -1)
        if isinstance(value, BeamSection)
        else np.asarray(value)
    )


def _with_arrays(machine: Machine, arrays: dict[str, NDArray]) -> Machine:
    """Return the machine with arrays replaced by field."""
    legs = {name: array for name, array in arrays.items() if name in _OF_LEGS}
    other_arrays: dict[str, Any] = {name: array for name, array in arrays.items() if name not in _OF_LEGS}
    other_arrays |= {
        name: BeamSection(*np.moveaxis(other_arrays[name], -1, 0))
        for name in ("flexure", "tube")
        if name in other_arrays
    }
    return replace(machine, legs=machine.legs.replace(**legs), **other_arrays)


def report_set(machine: Machine, deformation: str) -> ParameterSet:
    """Return the parameters that the telescope report identifies under a deformation (its tables 5 to 7).

    ``none``: a_x a_y b_x b_y u_x l; ``linear`` and ``matrix``: kappa, the diagonal of K, instead of u_x. Closures
    without u lack u_x; if u is not along z, its smallest component replaces u_x.
    """
    _check(deformation)
    legs = range(machine.legs.count)
    joints = [_millimetres(f"{name}_{axis}", leg) for name in "ab" for axis in "xy" for leg in legs]
    lengths = [_millimetres("l", leg) for leg in legs]
    if deformation != "none":
        return ParameterSet((*joints, *(_ratio("kappa", leg) for leg in legs), *lengths))
    return ParameterSet((*joints, *_directions(machine, 1), *lengths))


def full_set(
    machine: Machine,
    deformation: str,
    *,
    rho0: bool = False,
    flexure_length: bool = False,
    beta: bool = False,
    sections: bool = False,
) -> ParameterSet:
    """Return all of a, b, u (if the closure has one) and l, and the deformation's kappa or all of K.

    On request also the reference readings, lengths and beta of the flexures, and the stiffnesses of flexures and tubes.
    """
    legs = range(machine.legs.count)
    entries = [_millimetres(f"{name}_{axis}", leg) for name in "ab" for axis in _AXES for leg in legs]
    entries += _directions(machine, 2)
    for name, wanted in (("l", True), ("rho0", rho0), ("flexure_length", flexure_length)):
        entries += [_millimetres(name, leg) for leg in legs if wanted]
    entries += [_ratio("beta", leg) for leg in legs if beta]
    return ParameterSet((*entries, *deformation_set(machine, deformation).entries, *_sections(sections)))


def deformation_set(machine: Machine, deformation: str) -> ParameterSet:
    """Return the parameters of a deformation: none, kappa of each leg, K row by row, or K with its rows along x and
    y."""
    _check(deformation)
    count = machine.legs.count
    if deformation in ("matrix", "in-plane"):
        between = "_" if count > 9 else ""
        kinds = ("K", *(_IN_PLANE if deformation == "in-plane" else ()))
        entries = ((kind, i, j) for kind in kinds for i in range(count) for j in range(count))
        return ParameterSet(tuple(_ratio(f"{kind}{i + 1}{between}{j + 1}", i) for kind, i, j in entries))
    return ParameterSet(tuple(_ratio("kappa", leg) for leg in range(count) if deformation == "linear"))


def _check(deformation: str) -> None:
    if deformation not in ("none", "linear", "matrix", "in-plane"):
        raise ValueError(f"deformation: found {deformation!r}, expected none, linear, matrix or in-plane")


def _directions(machine: Machine, count: int) -> list[LegParameter]:
    """Return the smallest components of each u, in the order of the axes; among equal ones the first."""
    if "u" not in machine.legs.closure.geometry:
        return []
    smallest = np.sort(np.argsort(np.abs(machine.legs.u), -1, kind="stable")[:, :count], -1)
    order = [(rank, leg) for rank in range(count) for leg in range(len(smallest))]
    return [_ratio(f"u_{_AXES[smallest[leg, rank]]}", leg) for rank, leg in order]


def _sections(wanted: bool) -> Sequence[LegParameter]:
    pairs = [(body, kind) for body in ("flexure", "tube") for kind in _STIFFNESS if wanted]
    return [LegParameter(f"{body}_{kind}", SHARED, _STIFFNESS[kind], 1.0) for body, kind in pairs]


def _millimetres(name: str, leg: int) -> LegParameter:
    return LegParameter(name, leg, "mm", 1e-3)


def _ratio(name: str, leg: int) -> LegParameter:
    return LegParameter(name, leg, "1", 1.0)
