"""Sampled tolerances of a six-axis force sensor: python -m benchmarks.tolerances [--repeats 9] [--samples 1000000].

Platforms per second, with one thread and with two, on pinned processors: thirty normal errors each (five sources, six
legs), closed by the legs' lengths without linearising. Peers: NumPy (the same errors, Newton's method with a new 6x6
matrix for every platform, in blocks), and SciPy's root for one platform after the other. The drawing of the random
numbers alone is timed as well. A row prints a figure only if its legs have the lengths that they should, to rounding;
ours also only if one worker and all of them draw the same bytes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

from benchmarks.rows import record_row, timed_row
from benchmarks.timing import interleaved, pin, run_pinned, spread, thread_counts
from truing.estimation.rotation import exp_so3, left_jacobian_so3
from truing.simulation.bench.six_upur.geometry import JointCentres, joint_centres, outward
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.tolerances import assembled, sampled_errors, sigma_of

_SIGMA = 1e-6 * sigma_of([155.0, 130.0, 36.0, 36.0, 87.0])
SMALLEST = ("--samples", "4096", "--repeats", "1", "--threads", "1")
_OURS, _ALONE = "truing sampled_errors", "30 normal numbers alone"
_FEW, _BLOCK = 200, 2048
_ROUNDING = 1e-14  # of half a metre
_BELOW, _ABOVE = (np.radians([h, -h, h - 120, -h - 120, 120 - h, 120 + h]) for h in (20.0, 29.00863))


def sensor() -> JointCentres:
    """Return a sensor of 550 mm, 550 mm and 300 mm."""
    lower, upper = (0.55 * np.stack([np.cos(a), np.sin(a), 0.0 * a], -1) for a in (_BELOW, _ABOVE))
    return joint_centres(lower, upper, 0.3)


def drawn(count: int, seed: int) -> np.ndarray:
    """Return errors (count, 6, 5), m."""
    return _SIGMA * np.random.default_rng(seed).standard_normal((count, 6, 5))


def by_numpy(joints: JointCentres, count: int) -> np.ndarray:
    """Return platforms (count, 6) by Newton's method, batched over blocks."""
    return np.concatenate([_newton(joints, drawn(_BLOCK, k)) for k in range(-(-count // _BLOCK))])[:count]


def _newton(joints: JointCentres, errors: np.ndarray) -> np.ndarray:
    lower, arm, length = manufactured(joints, errors)
    x = np.zeros((len(errors), 6))
    for _ in range(3):
        R = exp_so3(x[:, 3:])
        turned = arm @ np.swapaxes(R, 1, 2)
        stands = JointCentres(lower, turned, joints.origin + x[:, :3])
        rows = np.swapaxes(influence_matrix(stands), 1, 2)
        rows[..., 3:] = rows[..., 3:] @ left_jacobian_so3(x[:, 3:])
        x = x - np.linalg.solve(rows, (stands.length - length)[..., None])[..., 0]
    return x


def by_scipy(joints: JointCentres) -> np.ndarray:
    """Return the first platforms (few, 6), one by one."""
    from scipy.optimize import root

    lower, arm, length = manufactured(joints, drawn(_FEW, 0))

    def short(x: np.ndarray, k: int) -> np.ndarray:
        leg = joints.origin + x[:3] + arm[k] @ exp_so3(x[3:]).T - lower[k]
        return np.sqrt(np.sum(leg * leg, -1)) - length[k]

    return np.array([root(short, np.zeros(6), (k,), tol=1e-14).x for k in range(_FEW)])


def manufactured(joints: JointCentres, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return joints B and b (N, 6, 3) and lengths (N, 6) of sensors with errors (N, 6, 5), m."""
    lower = joints.lower + outward(joints.lower) * errors[..., 1, None]
    arm = joints.arm + outward(joints.arm) * errors[..., 0, None]
    return lower, arm, joints.length + errors[..., 2] - errors[..., 3] + errors[..., 4]


def off(joints: JointCentres, errors: np.ndarray, x: np.ndarray) -> float:
    """Return the largest error of the legs' lengths at platform poses x (N, 6), relative to half a metre."""
    lower, arm, length = manufactured(joints, errors)
    leg = (joints.origin + x[:, :3])[:, None] + arm @ np.swapaxes(exp_so3(x[:, 3:]), 1, 2) - lower
    return float(np.abs(np.sqrt(np.sum(leg * leg, -1)) - length).max() / 0.5)


def measure(samples: int, threads: int, repeats: int) -> None:
    """Print one line per row."""
    joints = sensor()

    def ours(workers: int) -> np.ndarray:
        return sampled_errors(joints, _SIGMA, samples, np.random.default_rng(1), workers=workers)

    few = max(_BLOCK, samples // 20)
    rows: dict[str, tuple[int, Callable[[], object]]] = {
        _OURS: (samples, lambda: ours(threads)),
        "NumPy, Newton, batched": (few, lambda: by_numpy(joints, few)),
        "scipy root, one by one": (_FEW, lambda: by_scipy(joints)),
        _ALONE: (few, lambda: np.random.default_rng(1).standard_normal((few, 30))),
    }
    print(f"\n{samples:,} sensors, {threads} thread(s): platforms per second, minimum median maximum", flush=True)
    faults = {
        _OURS: off(joints, drawn(_BLOCK, 0), assembled(joints, drawn(_BLOCK, 0))),
        "NumPy, Newton, batched": off(joints, drawn(_BLOCK, 0), by_numpy(joints, _BLOCK)),
        "scipy root, one by one": off(joints, drawn(_FEW, 0), by_scipy(joints)),
    }
    if ours(1).tobytes() != ours(threads).tobytes():
        faults[_OURS] = np.inf
    seconds = interleaved({name: task for name, (_, task) in rows.items()}, repeats)
    each = {name: seconds[name] / count for name, (count, _) in rows.items()}
    missed = [name for name, wrong in faults.items() if not wrong < _ROUNDING]
    what = f"sensor within tolerances, {threads} thread(s)"
    record_row(timed_row(what, each, _OURS, own=[_ALONE], missed=missed, unit="µs", least_ratio=5.0))
    for name, (count, _) in rows.items():
        wrong = faults.get(name, 0.0)
        text = spread(count / seconds[name]) if wrong < _ROUNDING else "no figure: legs have not their lengths"
        print(f"{name:26} {text}  lengths off by {wrong:.0e}", flush=True)


def main() -> None:
    """Run in a process of its own for each number of threads."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--threads", type=int, help="measure here with so many threads (used by the program itself)")
    options = parser.parse_args()
    if options.threads is not None:
        pin(options.threads)
        measure(options.samples, options.threads, options.repeats)
        return
    for threads in thread_counts():
        passed_on = ["--samples", str(options.samples), "--repeats", str(options.repeats)]
        run_pinned("benchmarks.tolerances", passed_on, threads)


if __name__ == "__main__":
    main()
