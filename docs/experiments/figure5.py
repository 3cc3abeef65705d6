"""Figure 5 of the telescope report: the pose of 6 to 20 points on a thin cylinder, line fit against point fit.

    python -m docs.experiments.figure5

simulates every case, draws docs/figures/figure5.svg and renews the tables of docs/poses.md. The same numbers on every
run: each case has a seed of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.chart import Panel, Series, write_chart
from docs.experiments.marked_tables import renew
from truing.estimation.rigid_poses.haralick import haralick
from truing.estimation.rigid_poses.line_fit import fit_line
from truing.estimation.rigid_poses.rigid import RigidFit
from truing.estimation.rigid_poses.robust_pose import robust_pose
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3, log_so3

LENGTH, RADIUS, SIGMA = 50e-3, 1e-3, 5e-6
COUNTS = range(6, 21)
TRIALS = 1000
DOCS = Path(__file__).resolve().parents[1]

Noise = Callable[[np.random.Generator, tuple[int, ...]], NDArray]
NOISES: dict[str, tuple[Noise, float]] = {
    "Gaussian": (lambda rng, shape: SIGMA * rng.normal(size=shape), 1.0),
    "uniform": (lambda rng, shape: rng.uniform(-2 * SIGMA, 2 * SIGMA, shape), 2 / np.sqrt(3)),
}


@dataclass(frozen=True)
class Errors:
    """Root mean squares over the trials: centroid in m (3-D), tilt and roll of the axis in rad; NaN where none."""

    position: float
    tilt: float
    roll: float


def cylinder(count: int) -> NDArray:
    """Points (count, 3), in m, spread evenly over the cylinder: equal steps along it, golden angle about it."""
    k = np.arange(count)
    angle = k * np.pi * (3 - np.sqrt(5))
    return np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), (k + 0.5) * LENGTH / count], axis=1)


def bound(count: int) -> Errors:
    """The Cramér-Rao bound for Gaussian noise on the measured points."""
    x = cylinder(count)
    covariance = umeyama(x - x.mean(axis=0), x, sigma=SIGMA).covariance
    tilt = np.trace(covariance[3:5, 3:5])
    return Errors(*np.sqrt([np.trace(covariance[:3, :3]), tilt, covariance[5, 5]]))


@cache
def simulate(count: int, noise: str, gross: float = 0.0, trials: int = TRIALS) -> dict[str, Errors]:
    """Errors of each method for `count` points; ``gross``, in m, moves the first point across the axis."""
    rng = np.random.default_rng([count, list(NOISES).index(noise), int(1e6 * gross)])
    x = cylinder(count)
    R = exp_so3(rng.normal(size=(trials, 3)))
    t = rng.normal(size=(trials, 3))
    y = x @ np.swapaxes(R, 1, 2) + t[:, None] + NOISES[noise][0](rng, (trials, count, 3))
    across = rng.normal(size=(trials, 2))
    y[:, 0] += gross * np.einsum("bij,bj->bi", R[:, :, :2], across / np.linalg.norm(across, axis=1, keepdims=True))
    mask = np.ones((trials, count), bool)
    cov = np.broadcast_to(SIGMA**2 * np.eye(3), (trials, count, 3, 3))
    fits = {
        "least squares": umeyama(x, y),
        "Haralick": haralick(x, y, 0.0, SIGMA)[0],
        "default": robust_pose(x, y, np.zeros((count, 3, 3)), cov, mask)[0],
    }
    return {"line": _line_errors(x, y, R, t), **{name: _errors(fit, x, R, t) for name, fit in fits.items()}}


def _errors(fit: RigidFit, x: NDArray, R: NDArray, t: NDArray) -> Errors:
    ok = fit.ok
    centre = x.mean(axis=0)
    position = (fit.R @ centre + fit.t - R @ centre - t)[ok]
    turn = np.einsum("bji,bj->bi", R, log_so3(np.where(ok[:, None, None], fit.R, R) @ np.swapaxes(R, 1, 2)))[ok]
    return Errors(_rms(position), _rms(turn[:, :2]), _rms(turn[:, 2:]))


def _line_errors(x: NDArray, y: NDArray, R: NDArray, t: NDArray) -> Errors:
    start = fit_line(x, [0, 0, 1.0], sigma=SIGMA)
    axis = R @ start.direction[0]
    fit = fit_line(y, axis, sigma=SIGMA)
    return Errors(_rms(fit.position - R @ start.position[0] - t), _rms(np.cross(axis, fit.direction)), np.nan)


def _rms(errors: NDArray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


def table(noise: str, gross: float = 0.0) -> str:
    """Errors over bound, as a table of the docs, for a few numbers of points."""
    factor = NOISES[noise][1]
    lines = [
        "| points | bound: position, tilt, roll | line | least squares | Haralick | default |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for count in (6, 8, 10, 15, 20):
        limit, found = bound(count), simulate(count, noise, gross)
        first = f"{1e6 * factor * limit.position:.2f} µm, {1e6 * factor * limit.tilt:.0f} µrad, "
        first += f"{1e6 * factor * limit.roll:.0f} µrad"
        cells = [_ratios(errors, limit, factor) for errors in found.values()]
        lines.append(f"| {count} | {first} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _ratios(errors: Errors, limit: Errors, factor: float) -> str:
    pairs = ((errors.position, limit.position), (errors.tilt, limit.tilt), (errors.roll, limit.roll))
    return ", ".join("none" if np.isnan(e) else f"{e / b / factor:.3g}" for e, b in pairs)


def draw(path: Path) -> None:
    """Draw the six panels: position, tilt and roll, without and with one gross error."""
    limits = [bound(count) for count in COUNTS]
    panels = []
    for title, gross in (("Gaussian noise 5 µm", 0.0), ("the same, one point 0.2 mm off", 2e-4)):
        found = [simulate(count, "Gaussian", gross) for count in COUNTS]
        for quantity, unit in (("position", "µm"), ("tilt", "µrad"), ("roll", "µrad")):
            series = [Series("bound", [1e6 * getattr(b, quantity) for b in limits])]
            for method in found[0]:
                series.append(Series(method, [1e6 * getattr(f[method], quantity) for f in found]))
            panels.append(Panel(f"{quantity}, {title}", f"rms error, {unit}", list(COUNTS), series))
    write_chart(path, panels, columns=3, x_label="number of points")


def breakdown_table(trials: int = TRIALS) -> str:
    """Share of poses found with 20 points in a cube of 0.3 m, some of them millimetres off; a table of the docs."""
    lines = ["| gross errors among 20 points | least squares | Haralick | default |", "| --- | --- | --- | --- |"]
    for outliers in (0, 2, 4, 6, 8, 10, 12, 14, 16):
        rng = np.random.default_rng([20, outliers])
        x = rng.uniform(-0.15, 0.15, (20, 3))
        y = x + SIGMA * rng.normal(size=(trials, 20, 3))
        bad = np.argsort(rng.uniform(size=(trials, 20))) < outliers
        y += bad[..., None] * 2e-3 * rng.normal(size=y.shape)
        cov = np.broadcast_to(SIGMA**2 * np.eye(3), (trials, 20, 3, 3))
        fits = (
            umeyama(x, y),
            haralick(x, y, 0.0, SIGMA)[0],
            robust_pose(x, y, np.zeros((20, 3, 3)), cov, np.ones((trials, 20), bool))[0],
        )
        # five standard deviations of the position that the good points alone would give
        near = [f.ok & (np.linalg.norm(f.t, axis=-1) < 5 * SIGMA * np.sqrt(3 / (20 - outliers))) for f in fits]
        lines.append(f"| {outliers} | {' | '.join(f'{100 * n.mean():.1f} %' for n in near)} |")
    return "\n".join(lines)


TABLES: dict[str, Callable[[], str]] = {
    "gaussian": lambda: table("Gaussian"),
    "uniform": lambda: table("uniform"),
    "gross": lambda: table("Gaussian", 2e-4),
    "breakdown": breakdown_table,
}


def main() -> None:
    """Renew the figure and the tables."""
    draw(DOCS / "figures" / "figure5.svg")
    renew(DOCS / "poses.md", TABLES)


if __name__ == "__main__":
    main()
