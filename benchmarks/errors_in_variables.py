"""Errors-in-variables calibration compared with other solvers: python -m benchmarks.errors_in_variables.

42 values of six legs and 6 deviations of each of 40 poses, with a prior on the values: 282 unknowns, 522 residuals, all
libraries from the nominal values on the identical sum of squares, with exact derivatives. A row whose sum is not within
1e-6 of the least one prints no ratio; a library that is not installed prints "unmeasured". Ours includes the covariance
of the values; the others solve. One thread and two, on pinned processors, repeats interleaved.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.errors_in_variables_peers import PEERS, Solver
from benchmarks.errors_in_variables_problem import (
    POSE_SIGMA,
    READING_SIGMA,
    TOLERANCE,
    Joint,
    constrain,
    cost,
    draw,
)
from benchmarks.rows import record_row, timed_row
from benchmarks.timing import interleaved, pin, run_pinned, thread_counts
from truing.estimation.errors_in_variables.fit import Constraint, Prior, fit_errors_in_variables
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine

_OURS = "truing"
SMALLEST = ("--repeats", "1", "--threads", "1", "--poses", "8")
_NAMES = ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "l")


def product(problem: Joint) -> Constraint:
    """Return the same equations as the product poses them, from the mechanism's own description."""
    parameters = ParameterSet(tuple(LegParameter(name, leg, "", 1.0) for leg in range(6) for name in _NAMES))
    machine = Machine(problem.legs, np.zeros((6, 6)))
    model = KinematicModel("6-pus")
    return CalibrationProblem(model, machine, parameters, problem.p, problem.R, problem.rho).constrain


def ours(problem: Joint, equations: Constraint, robust: bool) -> Solver:
    """Return our fit."""
    C = np.zeros((len(problem.p), 12, 12))
    C[:, :6, :6] = problem.covariance
    C[:, 6:, 6:] = READING_SIGMA**2 * np.eye(6)
    prior = Prior(problem.start, np.diag(TOLERANCE**-2))

    def solve() -> tuple[np.ndarray, np.ndarray]:
        fit = fit_errors_in_variables(equations, C, problem.start, prior, robust=robust)
        return (fit.values - problem.start) / TOLERANCE, fit.deviations[:, :6] / POSE_SIGMA

    return solve


def solvers(problem: Joint) -> dict[str, Solver]:
    """Return all solvers that load here; the others are named as unmeasured."""
    found = {
        _OURS: ours(problem, partial(constrain, problem), False),
        "truing, bad poses sought": ours(problem, partial(constrain, problem), True),
        "truing, CalibrationProblem": ours(problem, product(problem), False),
    }
    for name, factory in PEERS.items():
        try:
            found[name] = factory(problem)
        except ImportError as error:
            print(f"{name:32} unmeasured ({str(error).splitlines()[0][:60]})")
    return found


def compare(poses: int, threads: int, repeats: int) -> None:
    """Print milliseconds of every solver and, where it reached the least sum, how many times faster ours is."""
    print(f"\n{poses} poses, {threads} thread(s): milliseconds per fit, minimum median maximum")
    problem = draw(poses, 1)
    found = solvers(problem)
    reached = {name: cost(problem, *solve()) for name, solve in found.items()}
    tasks: dict[str, Callable[[], object]] = dict(found)
    seconds = interleaved(tasks, repeats)
    missed = [name for name, sum_found in reached.items() if not sum_found <= (1 + 1e-6) * min(reached.values())]
    what = f"errors in variables, {poses} poses and 42 values, {threads} thread(s)"
    own = [name for name in found if name.startswith(_OURS)]
    unmeasured = [name for name in PEERS if name not in found]
    record_row(timed_row(what, seconds, _OURS, own=own, missed=missed, unmeasured=unmeasured, least_ratio=2.0))
    for name, s in seconds.items():
        low, middle, high = 1e3 * np.min(s), 1e3 * np.median(s), 1e3 * np.max(s)
        excess = reached[name] / min(reached.values()) - 1
        print(
            f"{name:32} {low:9.2f} {middle:9.2f} {high:9.2f}  {_verdict(name, excess, s / seconds[_OURS])}", flush=True
        )


def _verdict(name: str, excess: float, ratio: np.ndarray) -> str:
    """Return the ratio of a fit's time to ours (median and range of the repeats), or the reason why there is none."""
    if name == _OURS:
        return ""
    if not excess <= 1e-6:
        return f"no ratio: misses the least sum of squares by {excess:.1e}"
    return f"{np.median(ratio):.1f} times ours ({ratio.min():.1f} to {ratio.max():.1f})"


def main() -> None:
    """Measure all of it, one process per number of threads."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument(
        "--threads", type=int, choices=(1, 2), help="measure here; both, each in a process, if not given"
    )
    options = parser.parse_args()
    if options.threads is None:
        for threads in thread_counts():
            run_pinned(
                "benchmarks.errors_in_variables",
                ["--poses", str(options.poses), "--repeats", str(options.repeats)],
                threads,
            )
        return
    pin(options.threads)
    compare(options.poses, options.threads, options.repeats)


if __name__ == "__main__":
    main()
