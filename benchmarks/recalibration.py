"""Simulated re-calibrations of legs compared with loops of scipy: python -m benchmarks.recalibration [--repeats 9].

The telescope report's implicit calibration (eq. 30) of the six legs, six parameters each, over 40 poses of many
draws of a campaign, with one thread and with two, on pinned processors. Ours with covariance, rank and status;
scipy's Levenberg-Marquardt (MINPACK) with the analytic Jacobian, leg after leg, in as many processes as there are
threads, timed on the first draws. A row that misses the least sum of squares of any draw by more than 1e-6 of it
prints no ratio.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from benchmarks.rows import record_row, timed_row
from benchmarks.timing import interleaved, spread, threads_and_repeats
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.legs.closures import mechanism
from truing.simulation.mechanisms.parameters import ParameterSet, report_set
from truing.simulation.mechanisms.recalibration import LegDraws, calibrate_leg_plain, leg_draws, recalibrate
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, poses_at

SMALLEST = ("--repeats", "1", "--threads", "1", "--share", "0.06")
_DRAWS, _FEW, _POSES = 4096, 24, 40
_NOISE_M, _NOISE_RAD, _READING_M = 2e-6, 1e-5, 1e-6
KAPPA = 0.011
# The telescope's joints: radius, and polar angles of the legs, base and platform.
_RADII_M = 0.154, 0.135
_BASE_DEG = np.array([-140.8, -39.2, -20.8, 80.8, 99.2, 200.8])
_PLATFORM_DEG = np.array([-96.0, -84.0, 24.0, 36.0, 144.0, 156.0])

_OURS, _BY_QR = "truing recalibrate", "truing by QR"
Costs = Callable[[], np.ndarray]


def telescope(deformation: float) -> Machine:
    """Return the nominal telescope whose attachments each follow their own actuator by so much."""
    a, b = (_ring(radius, angles) for radius, angles in zip(_RADII_M, (_BASE_DEG, _PLATFORM_DEG), strict=True))
    return Machine(mechanism("6-pus", a, b, None, np.full(6, 0.5), np.full(6, 0.01)), deformation * np.eye(6))


def _ring(radius: float, angles_deg: np.ndarray) -> np.ndarray:
    angle = np.radians(angles_deg)
    return radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], 1)


def draws(nominal: Machine, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return poses (D, N, 3), (D, N, 3, 3) and readings (D, N, L) of a machine 0.5 mm off its drawing."""
    rng = np.random.default_rng(seed)
    legs = nominal.legs
    moved = {name: getattr(legs, name) + 5e-4 * rng.normal(size=getattr(legs, name).shape) for name in ("a", "b", "l")}
    rho = legs.rho0 + rng.uniform(-1.3e-3, 1.3e-3, (_POSES, 6))
    reached = poses_at(KinematicModel("6-pus"), Machine(legs.replace(**moved), nominal.deformation), rho)
    p = reached.p + _NOISE_M * rng.normal(size=(count, _POSES, 3))
    R = exp_so3(_NOISE_RAD * rng.normal(size=(count, _POSES, 3))) @ reached.R
    return p, R, rho + _READING_M * rng.normal(size=(count, _POSES, 6))


@dataclass(frozen=True)
class Peer:
    """scipy over draws and legs, one call each; costs (d, L) of the draws first..stop."""

    legs: list[LegDraws]
    solver: str

    def __call__(self, part: tuple[int, int]) -> np.ndarray:
        """Return the sums of squares of some of the draws."""
        return np.array([[self.solve(leg, draw) for leg in self.legs] for draw in range(*part)])

    def solve(self, leg: LegDraws, draw: int) -> float:
        """Return the sum of squares that scipy ends with."""
        from scipy.optimize import least_squares, leastsq

        residual, jacobian = _by_hand(leg, draw)
        start = leg.parameters.values(leg.machine)[0, 0]
        if self.solver == "leastsq":
            return float(np.sum(residual(leastsq(residual, start, Dfun=jacobian)[0]) ** 2))
        return float(2.0 * least_squares(residual, start, jacobian, method="lm", x_scale="jac").cost)


def _by_hand(leg: LegDraws, draw: int) -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """Return residual (N,) and Jacobian (N, 6) of one leg of one draw as one would write them for scipy, no more."""
    p, R, rho = leg.p[draw], leg.R[draw], leg.rho[draw, :, 0]
    names = [entry.name for entry in leg.parameters.entries]
    moved, has_kappa = rho - leg.machine.legs.rho0[0, 0, 0], "kappa" in names
    order = [("a_x", "a_y", "b_x", "b_y", "kappa" if has_kappa else "u_x", "l").index(name) for name in names]

    def joints(x: np.ndarray) -> tuple[np.ndarray, float, float]:
        a_x, a_y, b_x, b_y, free, length = x[np.argsort(order)]
        u_x = 0.0 if has_kappa else free
        u_z = np.sqrt(1.0 - u_x * u_x)
        g = p + R[:, :, 0] * b_x + R[:, :, 1] * b_y
        if has_kappa:
            g = g + R[:, :, 2] * (free * moved)[:, None]
        g[:, 0] -= a_x + rho * u_x
        g[:, 1] -= a_y
        g[:, 2] -= rho * u_z
        return g, length, u_x / u_z

    def residual(x: np.ndarray) -> np.ndarray:
        g, length, _ = joints(x)
        return length - np.sqrt(np.einsum("ni,ni->n", g, g))

    def jacobian(x: np.ndarray) -> np.ndarray:
        g, _, slope = joints(x)
        z = g / np.sqrt(np.einsum("ni,ni->n", g, g))[:, None]
        turned = np.einsum("nij,ni->nj", R, z)
        free = -turned[:, 2] * moved if has_kappa else rho * (z[:, 0] - slope * z[:, 2])
        columns = [z[:, 0], z[:, 1], -turned[:, 0], -turned[:, 1], free, np.ones(len(rho))]
        return np.stack([columns[k] for k in order], 1)

    return residual, jacobian


def by_qr(legs: list[LegDraws]) -> np.ndarray:
    """Return the sums of squares (D, L) of our calibrations without compiled code."""
    costs = []
    for leg in legs:
        start = np.broadcast_to(leg.parameters.values(leg.machine)[0], (len(leg.p), len(leg.parameters)))
        costs.append(calibrate_leg_plain(leg, start, np.arange(len(leg.p))).cost)
    return np.stack(costs, 1)


def compare(title: str, machine: Machine, parameters: ParameterSet, threads: int, repeats: int, share: float) -> None:
    """Print leg calibrations per second, minimum, median and maximum, and ratios where the minimum is the same."""
    print(f"\n{title}, {threads} thread(s): leg calibrations per second, minimum median maximum")
    count = max(10 * _FEW, round(share * _DRAWS))
    seen = draws(machine, count, 1)
    legs = [leg_draws(machine, parameters, leg, *seen) for leg in range(6)]
    few = [leg_draws(machine, parameters, leg, *(array[: 10 * _FEW] for array in seen)) for leg in range(6)]
    rows: dict[str, tuple[int, Costs]] = {
        _OURS: (count, lambda: recalibrate(machine, parameters, *seen).cost),
        _BY_QR: (10 * _FEW, lambda: by_qr(few)),
    }
    for solver in ("leastsq", "least_squares lm"):
        rows[f"scipy {solver}"] = (_FEW, _in_processes(Peer(legs, solver), threads))
    costs = {name: task() for name, (_, task) in rows.items()}
    least = np.minimum.reduce([cost[:_FEW] for cost in costs.values()])
    seconds = interleaved({name: task for name, (_, task) in rows.items()}, repeats)
    rates = {name: 6 * of / seconds[name] for name, (of, _) in rows.items()}
    worst_of = {name: float(np.max(cost[:_FEW] / least - 1.0)) for name, cost in costs.items()}
    missed = [name for name, worst in worst_of.items() if not worst <= 1e-6]
    each = {name: 1.0 / rate for name, rate in rates.items()}
    what = f"recalibration of a leg, {title}, {threads} thread(s)"
    record_row(timed_row(what, each, _OURS, own=[_BY_QR], missed=missed, unit="µs", least_ratio=20.0))
    for name, rate in rates.items():
        worst = worst_of[name]
        print(f"{name:24} {spread(rate)}  {_verdict(name, worst, rates)}", flush=True)
    apart = np.max(np.abs(costs[_BY_QR] / costs[_OURS][: 10 * _FEW] - 1.0))
    print(f"compiled against QR, {10 * _FEW} draws: sums of squares differ by {apart:.1e} of themselves at most")


def _verdict(name: str, worst: float, rates: dict[str, np.ndarray]) -> str:
    if not worst <= 1e-6:
        return f"no ratio: misses the least sum of squares by up to {worst:.1e}"
    ratio = rates[_OURS] / rates[name]
    return (
        ""
        if name == _OURS
        else f"recalibrate is {np.median(ratio):.1f} times as fast ({ratio.min():.1f} to {ratio.max():.1f})"
    )


def _in_processes(peer: Peer, processes: int) -> Costs:
    """Return a task that runs a peer over the first draws, in processes made beforehand."""
    if processes == 1:
        return lambda: peer((0, _FEW))
    pool = get_context("fork").Pool(processes)
    step = _FEW // processes
    small = Peer(
        [LegDraws(leg.machine, leg.parameters, leg.p[:_FEW], leg.R[:_FEW], leg.rho[:_FEW]) for leg in peer.legs],
        peer.solver,
    )
    return lambda: np.concatenate(pool.map(small, [(i * step, (i + 1) * step) for i in range(processes)]))


def main() -> None:
    """Measure all of it, one process per number of threads."""
    options = threads_and_repeats("benchmarks.recalibration", __doc__ or "")
    if options is None:
        return
    threads, repeats, share = options
    for deformation, value, title in (
        ("linear", KAPPA, "a_x a_y b_x b_y kappa l"),
        ("none", 0.0, "a_x a_y b_x b_y u_x l"),
    ):
        machine = telescope(value)
        compare(title, machine, report_set(machine, deformation), threads, repeats, share)


if __name__ == "__main__":
    main()
