"""Rigid fits and robust fits compared with other libraries: python -m benchmarks.pose [--repeats 9].

Batches of 100,000 poses of 20 points and of 40 poses of 100, with one thread and with two, on pinned processors. Ours
carry weights, covariances and all checks; the others fit, no more. A row whose fits are not all within 1e-6 of the
least sum of squares prints no ratio; a library that is not installed prints "unmeasured". Libraries that fit one pose
per call are timed on the first 1000. The robust part has 20 and 200 points in 5 um noise, with gross errors of
millimetres. It counts how often the pose is within noise of the truth, and compares its errors with those of a fit to
the right points (the oracle).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from benchmarks.pose_peers import FITS, Fit, teaser
from benchmarks.rows import Row, record_row, timed_row
from benchmarks.timing import interleaved, spread, threads_and_repeats

_OURS = "truing umeyama"
_EQUAL = 1e-6  # excess over the least sum of squares
SMALLEST = ("--repeats", "1", "--threads", "1", "--share", "0.001")
SIGMA = 5e-6  # m
_FEW = 1000  # poses of a batch that libraries without batches are timed on
_SIZES = ((100_000, 20), (40, 100))
_CELLS = ((20, 0.0), (20, 0.5), (20, 0.8), (200, 0.0), (200, 0.5), (200, 0.8), (200, 0.95))


def clouds(
    poses: int, points: int, wrong: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return source, target (B, N, 3) in m, which points are true (B, N), and the motions R (B, 3, 3), t (B, 3)."""
    rng = np.random.default_rng(seed)
    source = rng.uniform(-0.15, 0.15, (poses, points, 3))
    Q = np.linalg.qr(rng.normal(size=(poses, 3, 3)))[0]
    R = Q * np.sign(np.linalg.det(Q))[:, None, None]
    t = rng.uniform(-1.0, 1.0, (poses, 3))
    target = source @ np.swapaxes(R, 1, 2) + t[:, None] + SIGMA * rng.normal(size=source.shape)
    gross = rng.permuted(np.tile(np.arange(points) < round(wrong * points), (poses, 1)), axis=1)
    return source, target + gross[..., None] * 3e-3 * rng.normal(size=source.shape), ~gross, R, t


def cost(R: np.ndarray, t: np.ndarray, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the sums of squared distances (B,) in m^2."""
    return np.sum((target - source @ np.swapaxes(R, 1, 2) - t[:, None]) ** 2, axis=(1, 2))


def ours(threads: int) -> dict[str, Fit]:
    """Return our fits: as called by everybody, and the plain and the compiled form behind it."""
    from truing.estimation.rigid_poses.batched_kernel import solve
    from truing.estimation.rigid_poses.rigid import RigidFit, check_correspondences, solve_weighted
    from truing.estimation.rigid_poses.umeyama import umeyama

    def weighted(fit: Callable[..., RigidFit]) -> Fit:
        def fits(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            result = fit(source, target, np.ones(source.shape[:2]), sigma=SIGMA)
            return result.R, result.t

        return fits

    def plain(*arrays: np.ndarray, sigma: float) -> RigidFit:
        return solve_weighted(*check_correspondences(*arrays), sigma=sigma)

    def compiled(*arrays: np.ndarray, sigma: float) -> RigidFit:
        return solve(*arrays, sigma=sigma, threads=threads)

    forms: dict[str, Callable[..., RigidFit]] = {
        _OURS: umeyama,
        "truing compiled": compiled,
        "truing plain NumPy": plain,
    }
    return {name: weighted(form) for name, form in forms.items()}


def stream(arrays: list[np.ndarray], threads: int) -> None:
    """Read arrays once, in as many threads."""
    parts = [part for a in arrays for part in np.array_split(a.ravel(), threads)]
    if threads == 1:
        for part in parts:
            part.max()
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(np.max, parts))


def available(factories: dict[str, Callable[[], Fit]]) -> dict[str, Fit]:
    """Return the fits whose libraries load here; the others are named as unmeasured."""
    fits = {}
    for name, factory in factories.items():
        try:
            fits[name] = factory()
        except ImportError as error:
            print(f"{name:28} unmeasured ({str(error).splitlines()[0][:60]})")
    return fits


def compare_fits(poses: int, points: int, threads: int, repeats: int) -> None:
    """Print rates and, where the least squares are reached, ratios to ours of all fits of one size of batch."""
    print(f"\n{poses:,} poses x {points} points, {threads} thread(s): poses per second, minimum median maximum")
    source, target, *_ = clouds(poses, points, 0.0, 1)
    mine, others = ours(threads), available(FITS)
    least = np.minimum.reduce([cost(*fit(source, target), source, target) for fit in mine.values()])
    count = {name: poses if name in mine or "batched" in name else min(poses, _FEW) for name in (*mine, *others)}
    tasks: dict[str, Callable[[], object]] = {
        name: partial(fit, source[: count[name]], target[: count[name]]) for name, fit in (mine | others).items()
    }
    tasks["reading the same bytes"] = partial(stream, [source, target, np.ones((poses, points))], threads)
    seconds = interleaved(tasks, repeats)
    rates = {name: count.get(name, poses) / s for name, s in seconds.items()}
    excess = {name: excess_of(fit, source, target, least) for name, fit in (mine | others).items()}
    record_row(
        timed_row(
            f"rigid fit, {poses:,} poses of {points} points, {threads} thread(s)",
            {name: 1.0 / rates[name] for name in excess},
            _OURS,
            own=mine,
            missed=[name for name, size in excess.items() if not size <= _EQUAL],
            unmeasured=[name for name in FITS if name not in others],
            unit="µs",
            least_ratio=5.0 if poses >= _FEW else None,
        )
    )
    for name, rate in rates.items():
        print(f"{name:28} {spread(rate)}  {verdict(name, excess.get(name), rates)}", flush=True)


def excess_of(fit: Fit, source: np.ndarray, target: np.ndarray, least: np.ndarray) -> float:
    """Largest excess over the least sums of squares, as a share of them."""
    n = min(len(source), _FEW)
    return float(np.max(cost(*fit(source[:n], target[:n]), source[:n], target[:n]) / least[:n] - 1))


def verdict(name: str, excess: float | None, rates: dict[str, np.ndarray]) -> str:
    """Ratio of the peer's time to ours, repeat by repeat, or the reason why there is none."""
    if excess is None or name == _OURS:
        return ""
    if not excess <= _EQUAL:
        return f"no ratio: misses the least sum of squares by up to {excess:.1e}"
    ratio = rates[_OURS] / rates[name]
    return f"umeyama is {np.median(ratio):.2f} times as fast ({ratio.min():.2f} to {ratio.max():.2f})"


def robust_fits() -> dict[str, Fit]:
    """Return robust fits of poses: ours with a refit on the consensus, TEASER++ alone and with a refit of ours."""
    from truing.estimation.rigid_poses.robust import consensus
    from truing.estimation.rigid_poses.umeyama import umeyama

    def truing(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        fit = umeyama(source, target, consensus(source, target, None, SIGMA)[0], sigma=SIGMA)
        return fit.R, fit.t

    fits = {"truing consensus + refit": truing}
    bound = 4.5 * SIGMA
    other = available({"TEASER++": lambda: teaser(bound)})

    def refitted(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        R, t = other["TEASER++"](source, target)
        near = np.sum((target - source @ np.swapaxes(R, 1, 2) - t[:, None]) ** 2, axis=-1) <= bound**2
        fit = umeyama(source, target, near, sigma=SIGMA)
        return fit.R, fit.t

    return fits | other | ({"TEASER++ + refit": refitted} if other else {})


def compare_robust(points: int, wrong: float, repeats: int, share: float) -> None:
    """Print how often robust fits succeed, their rotation errors over the oracle's, and their rates; one thread."""
    from scipy.special import chdtri

    from truing.estimation.rigid_poses.umeyama import umeyama

    trials = max(100, round(share * (50_000 if points <= 20 else 4_000)))
    print(
        f"\n{points} points, {wrong:.0%} gross errors, 1 thread: success, error of rotation / oracle, fits per second"
    )
    source, target, true, R, t = clouds(trials, points, wrong, 2)
    oracle = umeyama(source, target, true, sigma=SIGMA)
    fits = robust_fits()
    count = {name: trials if name.startswith("truing") else min(trials, _FEW) for name in fits}
    tasks: dict[str, Callable[[], object]] = {
        name: partial(fit, source[: count[name]], target[: count[name]]) for name, fit in fits.items()
    }
    seconds = interleaved(tasks, repeats)
    each = {name: s / count[name] for name, s in seconds.items()}
    record_row(_robust_row(points, wrong, each))
    for name, fit in fits.items():
        n = count[name]
        error = pose_error(*fit(source[:n], target[:n]), R[:n], t[:n])
        size = np.einsum("bi,bij,bj->b", error, np.linalg.inv(oracle.covariance[:n]), error)
        success = size <= chdtri(6, 1e-6)
        best = pose_error(oracle.R[:n], oracle.t[:n], R[:n], t[:n])
        ratio = np.sqrt(np.mean(error[success, 3:] ** 2) / np.mean(best[success, 3:] ** 2))
        print(f"{name:28} {success.mean():8.2%} of {n:,} {ratio:7.3f} {spread(n / seconds[name])}", flush=True)


def _robust_row(points: int, wrong: float, each: dict[str, np.ndarray]) -> Row:
    """Row of fits that end with least squares: ours, and TEASER++ with a refit."""
    refit, alone = "TEASER++ + refit", "TEASER++"
    what = f"robust fit of {points} points, {wrong:.0%} gross errors"
    unmeasured = [] if refit in each else [refit]
    return timed_row(what, each, "truing consensus + refit", own=[alone], unmeasured=unmeasured, unit="µs")


def pose_error(R: np.ndarray, t: np.ndarray, R_true: np.ndarray, t_true: np.ndarray) -> np.ndarray:
    """Return errors (B, 6) in the order of the covariance; NaN, which is no success, where there is no fit."""
    from truing.estimation.rotation import log_so3

    turn = np.where(np.isfinite(R), R, np.eye(3)) @ np.swapaxes(R_true, 1, 2)
    lost = np.isnan(t)
    return np.concatenate([t - t_true, np.where(lost, np.nan, log_so3(turn))], axis=1)


def main() -> None:
    """Measure all of it, one process per number of threads."""
    options = threads_and_repeats("benchmarks.pose", __doc__ or "")
    if options is None:
        return
    threads, repeats, share = options
    for poses, points in _SIZES:
        compare_fits(max(2, round(share * poses)), points, threads, repeats)
    if threads == 1:
        for points, wrong in _CELLS:
            compare_robust(points, wrong, repeats, share)


if __name__ == "__main__":
    main()
