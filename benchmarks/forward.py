"""Forward kinematics of the telescope: python -m benchmarks.forward [--poses 100000] [--repeats 9].

Poses per second on one pinned processor, from readings within the actuators' range, as one batch and one reading at a
time. The peer is scipy's hybrid method of MINPACK, called pose by pose with our exact Jacobian on the first thousand. A
row prints a figure only if the inverse of each of its poses equals the given reading, to rounding.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.rows import record_row, timed_row
from benchmarks.timing import interleaved, pin, run_pinned, spread
from tests.simulation.mechanisms.telescope import K, readings, telescope
from truing.estimation.rotation import exp_so3, left_jacobian_so3
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import Forward, closure_rows, forward, inverse, leg_vectors, unit
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, poses_at

SMALLEST = ("--poses", "100", "--repeats", "1", "--threads", "1")
_FEW = 1000  # poses on which calls of one pose each are timed
_ROUNDING = 1e-14  # of half a metre, and of a radian; a few dozen times what a number of that size resolves


def solved_one_by_one(legs: Legs, rho: np.ndarray) -> Forward:
    """Return poses found by scipy.optimize.root, from the same start for all: the pose at the reference readings."""
    from scipy.optimize import root

    home = forward(legs, legs.rho0[None]).p[0]
    found = [root(_short, np.r_[home, 0, 0, 0], (legs, reading), jac=True, tol=1e-12) for reading in rho]
    x = np.array([result.x for result in found])
    return Forward(x[:, :3], exp_so3(x[:, 3:]), np.array([result.success for result in found]))


def _short(x: np.ndarray, legs: Legs, rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R = exp_so3(x[3:])
    g = leg_vectors(legs, x[:3], R, rho)
    rows = closure_rows(legs, R, unit(g))
    rows[:, 3:] = rows[:, 3:] @ left_jacobian_so3(x[3:])
    return np.sqrt(np.sum(g * g, -1)) - legs.l, rows


def one_by_one(legs: Legs, rho: np.ndarray) -> Forward:
    """Return our poses, of one call for each."""
    found = [forward(legs, reading[None]) for reading in rho]
    return Forward(*(np.concatenate([getattr(each, name) for each in found]) for name in ("p", "R", "converged")))


def rows(machine: Machine, rho: np.ndarray) -> dict[str, tuple[Callable[[], Forward], np.ndarray]]:
    """Return the timed calls with their readings (N, 6), m, by name.

    The platform deforms in the last two; in the others the telescope is rigid.
    """
    legs, few = machine.legs, rho[:_FEW]
    bent = machine.delta_bz(rho)
    model = KinematicModel(legs.closure.name)
    return {
        "truing forward": (partial(forward, legs, rho), rho),
        "truing forward, one by one": (partial(one_by_one, legs, few), few),
        "scipy root, one by one": (partial(solved_one_by_one, legs, few), few),
        "truing forward, platform deforms": (partial(forward, legs, rho, bent), rho),
        "truing poses_at, platform deforms": (partial(poses_at, model, machine, rho), rho),
    }


def faults(found: Forward, legs: Legs, rho: np.ndarray, shift: np.ndarray | float) -> float:
    """Return the largest error of the poses' readings, relative to half a metre; infinite if a pose failed."""
    back = inverse(legs, found.p, found.R, shift)
    return float(np.abs(back - rho).max() / 0.5) if found.converged.all() else np.inf


def measure(poses: int, repeats: int) -> None:
    """Print one line per row."""
    print(f"{poses:,} poses, one thread: poses per second, minimum median maximum")
    machine = Machine(telescope(), K)
    timed = rows(machine, readings(np.random.default_rng(1), poses))
    seconds = interleaved({name: task for name, (task, _) in timed.items()}, repeats)
    each = {name: s / len(timed[name][1]) for name, s in seconds.items()}
    ours = "truing forward"
    own = [name for name in each if name.startswith("truing")]
    apart = {
        name: faults(task(), machine.legs, rho, machine.delta_bz(rho) if name.endswith("deforms") else 0.0)
        for name, (task, rho) in timed.items()
    }
    missed = [name for name, off in apart.items() if not off < _ROUNDING]
    record_row(timed_row("pose from readings", each, ours, own=own, missed=missed, unit="µs", least_ratio=100.0))
    for name, (_, rho) in timed.items():
        off = apart[name]
        text = spread(len(rho) / seconds[name]) if off < _ROUNDING else "no figure: the poses are not those asked for"
        print(f"{name:36} {text}  readings off by {off:.1e}", flush=True)


def main() -> None:
    """Run in a process of its own with one processor."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--threads", type=int, help="measure here with so many threads (used by the program itself)")
    options = parser.parse_args()
    if options.threads is None:
        run_pinned("benchmarks.forward", ["--poses", str(options.poses), "--repeats", str(options.repeats)], 1)
    else:
        pin(options.threads)
        measure(options.poses, options.repeats)


if __name__ == "__main__":
    main()
