"""Calibration of many simulated draws of a campaign, leg by leg (telescope report, eq. 30), for Monte Carlo.

The residual of a leg depends only on its own parameters, so that each leg of each draw is a separate small problem. The
shift of its attachment by the other legs' readings is known and is added to the platform's position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.least_squares.solver import (
    Method,
    Minima,
    Solution,
    SolverStatus,
    distinct_minima,
    join_solutions,
    least_squares,
)
from truing.simulation.mechanisms.parameters import ParameterSet
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine

# Parameters of a leg, in the order of the compiled code.
_NUMBERS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "u_z", "l", "kappa", "rho0")
_DRAWS_AT_ONCE = 1000
# Number of draws from which compiled code is faster, although loading it takes 0.5 s.
_WORTH_COMPILED_CODE = 400


@dataclass(frozen=True)
class Recalibrations:
    """Calibrations of D draws of a campaign, each leg by itself; SI."""

    names: tuple[tuple[str, ...], ...]  # L x P, names of each leg's values
    values: NDArray  # (D, L, P)
    cost: NDArray  # (D, L) m^2, sum of squared residuals
    covariance: NDArray  # (D, L, P, P) for residuals with a standard deviation of 1 m
    status: NDArray  # (D, L) of SolverStatus values (str)
    iterations: NDArray  # (D, L)

    @property
    def ok(self) -> NDArray:
        """Mask (D, L) of the calibrations that reached a minimum with all parameters determined."""
        return self.status == SolverStatus.CONVERGED


@dataclass(frozen=True)
class LegDraws:
    """Data of one leg in D draws of a campaign, and the leg as a separate mechanism."""

    machine: Machine  # of this leg alone
    parameters: ParameterSet  # of leg 0
    p: NDArray  # (D, N, 3) m, platform, plus the shift of this leg's attachment by the other legs' readings
    R: NDArray  # (D, N, 3, 3)
    rho: NDArray  # (D, N, 1) m


def recalibrate(
    machine: Machine,
    parameters: ParameterSet,
    p: NDArray,
    R: NDArray,
    rho: NDArray,
    *,
    start: NDArray | None = None,
    method: Method = "trust-region",
) -> Recalibrations:
    """Calibrate D draws of poses p (D, N, 3), R (D, N, 3, 3), m, and readings rho (D, N, L), m.

    parameters: the same number for every leg, none shared. All other numbers are those of the machine, at which the
    fits start if ``start`` (D, L, P) is None. Arrays with D = 1 apply to all draws. Raises ValueError for parameters
    that are not a single leg's.
    """
    draws_of_legs = [leg_draws(machine, parameters, leg, p, R, rho) for leg in range(machine.legs.count)]
    begin = nominal_values(machine, parameters)[None] if start is None else start
    (draws,) = np.broadcast_shapes(*(array.shape[:1] for array in (begin, p, R, rho)))
    begin = np.broadcast_to(begin, (draws, *begin.shape[1:]))
    fits = [calibrate_leg(leg, begin[:, i], method) for i, leg in enumerate(draws_of_legs)]
    names = tuple(tuple(entry.name for entry in leg.parameters.entries) for leg in draws_of_legs)
    fields = ("x", "cost", "covariance", "status", "iterations")
    return Recalibrations(names, *(np.stack([getattr(fit, field) for fit in fits], 1) for field in fields))


def nominal_values(machine: Machine, parameters: ParameterSet) -> NDArray:
    """Return the machine's values (L, P) of the parameters, leg by leg; errors as for `recalibrate`."""
    parameter_sets = [_leg_parameters(parameters, leg) for leg in range(machine.legs.count)]
    counts = [len(entries) for entries in parameter_sets]
    if len(set(counts)) != 1:
        raise ValueError(f"parameters: found {counts} per leg, expected the same number for each leg")
    return np.stack([entries.values(_single(machine, leg))[0, 0] for leg, entries in enumerate(parameter_sets)])


def minima_from(
    machine: Machine,
    parameters: ParameterSet,
    p: NDArray,
    R: NDArray,
    rho: NDArray,
    start: NDArray,
    method: Method = "trust-region",
) -> list[Minima]:
    """Return the distinct minima of each leg's calibration that are reached from starts (S, L, P).

    One campaign: poses p (N, 3), R (N, 3, 3), readings rho (N, L), m; errors as for `recalibrate`.
    """
    legs = [leg_draws(machine, parameters, leg, p[None], R[None], rho[None]) for leg in range(machine.legs.count)]
    return [distinct_minima(calibrate_leg(leg, start[:, i], method)) for i, leg in enumerate(legs)]


def _leg_parameters(parameters: ParameterSet, leg: int) -> ParameterSet:
    """Return one leg's parameters, as those of a machine with a single leg."""
    unknown = sorted({entry.name for entry in parameters.entries if entry.name not in _NUMBERS})
    if unknown:
        raise ValueError(
            f"parameters: found {', '.join(unknown)}, expected parameters of one leg: {', '.join(_NUMBERS)}"
        )
    return ParameterSet(tuple(replace(entry, leg=0) for entry in parameters.entries if entry.leg == leg))


def leg_draws(machine: Machine, parameters: ParameterSet, leg: int, p: NDArray, R: NDArray, rho: NDArray) -> LegDraws:
    """Return the data of one leg in all draws; arrays and errors as for `recalibrate`."""
    other_legs = machine.deformation[leg].copy()
    other_legs[leg] = 0.0
    seen = p + R[..., 2] * ((rho - machine.legs.rho0) @ other_legs)[..., None] if other_legs.any() else p
    single, parameter_set = _single(machine, leg), _leg_parameters(parameters, leg)
    return LegDraws(
        parameter_set.machine(single, parameter_set.values(single)), parameter_set, seen, R, rho[..., leg : leg + 1]
    )


def _single(machine: Machine, leg: int) -> Machine:
    """Return one leg as a mechanism, with batch axes for draws and poses before the leg."""
    only = slice(leg, leg + 1)
    arrays = {name: getattr(machine.legs, name)[None, None, only] for name in ("a", "b", "u", "l", "rho0")}
    return Machine(machine.legs.replace(**arrays), machine.deformation[None, None, only, only])


def calibrate_leg(leg: LegDraws, start: NDArray, method: Method = "trust-region") -> Solution:
    """Calibrate one leg from starts (D, P); many draws by the trust region use compiled code."""
    if method == "trust-region" and leg.machine.legs.closure.name == "6-pus" and len(start) >= _WORTH_COMPILED_CODE:
        return calibrate_leg_compiled(leg, start)
    return calibrate_leg_plain(leg, start, np.arange(len(start)), method)


def calibrate_leg_plain(leg: LegDraws, start: NDArray, draws: NDArray, method: Method = "trust-region") -> Solution:
    """Calibrate one leg in some of the draws (d,), by QR; starts (D, P)."""
    arrays = [np.broadcast_to(array, (len(start), *array.shape[1:])) for array in (leg.p, leg.R, leg.rho)]
    parts = []
    for some in np.array_split(draws, max(1, len(draws) // _DRAWS_AT_ONCE)):
        data = (array[some] for array in arrays)
        parts.append(least_squares(leg_residuals(leg), start[some], *data, method=method))
    return join_solutions(parts)


def calibrate_leg_compiled(leg: LegDraws, start: NDArray, threads: int | None = None) -> Solution:
    """Calibrate one leg of fixed length from starts (D, P), compiled; draws without convergence are repeated by QR."""
    from truing.simulation.mechanisms.recalibration_kernel import solve

    legs, deformation = leg.machine.legs, leg.machine.deformation[0, 0, 0]
    parts = (legs.a[0, 0, 0], legs.b[0, 0, 0], legs.u[0, 0, 0], legs.l[0, 0], deformation, legs.rho0[0, 0])
    slots = np.array([_NUMBERS.index(entry.name) for entry in leg.parameters.entries])
    fits = solve(np.concatenate(parts), slots, start, leg.p, leg.R, leg.rho[..., 0], threads=threads)
    status = np.full(len(start), str(SolverStatus.CONVERGED), np.array([str(s) for s in SolverStatus]).dtype)
    rank = np.full(len(start), start.shape[1])
    solution = Solution(fits.x, fits.cost, fits.covariance, rank, status, fits.iterations)
    unclear = np.flatnonzero(~fits.arrived)
    if len(unclear):
        solution.put(unclear, calibrate_leg_plain(leg, start, unclear))
    return solution


def leg_residuals(leg: LegDraws) -> Callable[..., tuple[NDArray, NDArray]]:
    """Return the function from values, p, R and rho to the residuals (B, N), m, of a leg and derivatives (B, N, P)."""
    model = KinematicModel(leg.machine.legs.closure.name)

    def residuals(values: NDArray, p: NDArray, R: NDArray, rho: NDArray) -> tuple[NDArray, NDArray]:
        machine = leg.parameters.machine(leg.machine, values[:, None])
        closing = model.close(machine, p, R, rho, leg.parameters.change(machine))
        return closing.value[..., 0], closing.by_parameter[..., 0, :]

    return residuals
