"""Kinematics and calibration of a robot arm compared with other libraries: python -m benchmarks.chains [--repeats 5].

The sample robot of six joints: 60 poses of three targets with 10 um of noise, geometry within its tolerances, a soft
shoulder and an eccentric elbow. First positions and Jacobians of the tip, poses per second; then calibrations: their
time, the rms of what they predict for 75 other poses against the exact places, and what they say of causes. scipy's
least squares with numeric derivatives on our own chain stands in for a calibration as it is usually written. One
pinned thread, repeats interleaved. A library that is not installed prints "unmeasured".
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.chains_peers import CALIBRATIONS, KINEMATICS, Calibrated, Jacobian, Series
from benchmarks.rows import record_row, timed_row
from benchmarks.timing import interleaved, pin, run_pinned, spread
from tests.blind.generator.arms.robot import other_poses, robot_campaign, write_robot
from tests.stages.line import run_line, settings_of
from truing.inference.fit import fit_model
from truing.simulation.mechanisms.chains.causes import ChainCause, JointCompliance
from truing.simulation.mechanisms.chains.conditions import APPROACH, ChainConditions
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.diagnosis.chain_points import assemble
from truing.stages.diagnosis.diagnosis_data import DiagnosisData
from truing.stages.diagnosis.search import search_causes

_OURS = "truing"
_WORSE = 2.0  # times the error of our predictions, from which on a calibration has missed the arm's causes
SMALLEST = ("--poses", "200", "--repeats", "1", "--threads", "1", "--steps", "2")
_SAME = 1e-9  # m, rad and their derivatives: all libraries read the same description


def ours(tree: Tree, tip: int) -> Jacobian:
    """Return the tip and its Jacobian of all poses at once."""
    node = np.array([tip])

    def found(readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        frames = tree.frames(readings)
        places = frames.t[:, node]
        return places[:, 0], tree.reading_slopes(frames, node, places)[:, 0]

    return found


def compare_kinematics(series: Series, tree: Tree, tip: int, poses: int, repeats: int) -> None:
    """Print poses per second of positions with Jacobians, and how many times faster ours is."""
    print(f"\n{poses:,} positions and Jacobians of the tip, one thread: poses per second, minimum median maximum")
    rng = np.random.default_rng(1)
    low, high = series.readings.min(0), series.readings.max(0)
    readings = low + (high - low) * rng.uniform(size=(poses, len(low)))
    tasks: dict[str, Jacobian] = {_OURS: ours(tree, tip)}
    for name, factory in KINEMATICS.items():
        try:
            tasks[name] = factory(series)
        except ImportError as error:
            print(f"{name:40} unmeasured ({str(error).splitlines()[0][:60]})")
    place, slopes = tasks[_OURS](readings)
    seconds = interleaved({name: partial(task, readings) for name, task in tasks.items()}, repeats)
    found = {name: task(readings) for name, task in tasks.items()}
    apart = {name: float(max(np.abs(p - place).max(), np.abs(by - slopes).max())) for name, (p, by) in found.items()}
    missed = [name for name, off in apart.items() if not off < _SAME]
    unmeasured = [name for name in KINEMATICS if name not in tasks]
    each = {name: s / poses for name, s in seconds.items()}
    record_row(
        timed_row("tip of an arm with its Jacobian", each, _OURS, missed=missed, unmeasured=unmeasured, unit="µs")
    )
    for name, off in apart.items():
        ratio = "" if name == _OURS else f"  {_ratio(seconds[name], seconds[_OURS])}"
        text = f"{spread(poses / seconds[name])}{ratio}" if off < _SAME else f"no figure: differs by {off:.1e}"
        print(f"{name:40} {text}", flush=True)


def _ratio(seconds: np.ndarray, own: np.ndarray) -> str:
    ratio = seconds / own
    return f"{np.median(ratio):.2g} times the time of ours ({ratio.min():.2g} to {ratio.max():.2g})"


def predictor(model: ChainModel, shared: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function from exact readings (B, n) to targets (B, K, 3) by a fitted chain."""

    def places(readings: np.ndarray) -> np.ndarray:
        count = len(readings)
        covariates = {"order": np.arange(count, dtype=float), APPROACH: np.ones(readings.shape)}
        conditions = ChainConditions(
            readings,
            covariates,
            tuple(range(count)),
            np.zeros(count, np.int64),
            np.tile(np.eye(3), (count, len(model.channels.names), 1, 1)),
            np.full(count, model.conditions.payload_kg[0]),
            model.conditions.columns,
        )
        return model.at(conditions).points(shared, np.zeros((count, model.local_size)))

    return places


def calibrations(data: DiagnosisData[Any], settings: Any, steps: int | None) -> dict[str, Callable[[], Calibrated]]:
    """Return ours, without and with the search for causes, and scipy's on the same chain, at most this many steps."""
    model, measured, frames = data.model, data.calibration.measured, data.calibration.frames
    soft = [JointCompliance(name, load=100.0) for name in model.tree.readings[1:]]

    def geometry() -> Calibrated:
        local = np.zeros((len(measured.is_observed), model.local_size))
        fit = fit_model(model.predict, measured, frames, np.zeros(model.shared_size), local)
        return Calibrated(predictor(model, fit.shared), "")

    def diagnosed() -> Calibrated:
        final = search_causes(data, settings, lambda *_: None).final
        return Calibrated(predictor(final.model, final.fit.shared), "; ".join(_words(final)))

    return {
        "truing, diagnosis with search for causes": diagnosed,
        "truing, geometry": geometry,
        "scipy, geometry": partial(_by_scipy, data, (), steps),
        "scipy, geometry and elastic joints": partial(_by_scipy, data, soft, steps),
    }


def _keep(results: dict[str, Calibrated], name: str, task: Callable[[], Calibrated]) -> None:
    results[name] = task()


def _words(final: Any) -> Iterator[str]:
    for cause in final.causes:
        sizes = cause.reported(*final.values(cause), final.model.part_count)
        numbers = ", ".join(f"{size.name} {size.value:.3g} ± {size.sigma or 0.0:.1g} {size.unit}" for size in sizes)
        yield f"{cause.id} {cause.subject} ({numbers})"


def _by_scipy(data: DiagnosisData[Any], causes: Sequence[ChainCause], steps: int | None) -> Calibrated:
    """Least squares with numeric derivatives over the unknowns of our chain, with the same tolerances."""
    from scipy.optimize import least_squares

    model, measured = data.model.with_causes(causes), data.calibration.measured
    local = np.zeros((len(measured.is_observed), model.local_size))

    def residuals(shared: np.ndarray) -> np.ndarray:
        away = np.einsum("bkij,bkj->bki", measured.whitener, measured.values - model.points(shared, local))
        return np.concatenate([away[measured.is_observed].ravel(), shared])

    found = least_squares(residuals, np.zeros(model.shared_size), method="trf", x_scale="jac", max_nfev=steps)
    effects = model.effects(found.x)
    text = ", ".join(f"{effect.cause.joint} {1e6 * effect.values[0]:.2f}" for effect in effects)
    return Calibrated(predictor(model, found.x), f"compliance, urad/(N m): {text}" if text else "")


def compare_calibrations(
    series: Series,
    tasks: dict[str, Callable[[], Calibrated]],
    other: tuple[np.ndarray, np.ndarray],
    repeats: int,
) -> None:
    """Print time, rms over the other poses, and causes, of tasks and of the peers' calibrations."""
    print("\nCalibrations: rms per coordinate of 75 other poses, um; seconds, minimum median maximum")
    for name, factory in CALIBRATIONS.items():
        try:
            tasks[name] = factory(series, series.urdf.parent)
        except ImportError as error:
            print(f"{name:42} unmeasured ({str(error).splitlines()[0][:60]})")
    results: dict[str, Calibrated] = {}
    seconds = interleaved({name: partial(_keep, results, name, task) for name, task in tasks.items()}, repeats)
    first = next(iter(tasks))
    own = [name for name in tasks if name.startswith(_OURS)]
    what = "calibration of an arm, ours with the search for causes"
    unmeasured = [name for name in CALIBRATIONS if name not in tasks]
    readings, exact = other
    rms_um = {
        name: 1e6 * float(np.sqrt(np.mean((found.places(readings) - exact) ** 2))) for name, found in results.items()
    }
    missed = [name for name, rms in rms_um.items() if rms > _WORSE * rms_um[first]]
    record_row(timed_row(what, seconds, first, own=own, missed=missed, unmeasured=unmeasured, unit="s"))
    for name, found in results.items():
        low, middle, high = np.min(seconds[name]), np.median(seconds[name]), np.max(seconds[name])
        ratio = "" if name == first else f"  {_ratio(seconds[name], seconds[first])}"
        print(f"{name:42} {rms_um[name]:6.1f} um {low:7.2f} {middle:7.2f} {high:7.2f} s{ratio}", flush=True)
        if found.says:
            print(f"{'':42} {found.says}", flush=True)


def measure(poses: int, repeats: int, steps: int | None) -> None:
    """Print both comparisons; steps: most of scipy's least squares, by default as many as it takes."""
    campaign = robot_campaign()
    with tempfile.TemporaryDirectory() as folder:
        sample = write_robot(Path(folder) / "robot")
        tables, _ = run_line(sample, "ingest")
        settings = settings_of(sample)
        data = replace(assemble(tables, settings), held_out=None)
        own = ~campaign.bench.schedule.held_out
        arm = campaign.bench.design.arm
        tip = arm.links[arm.tips[0]].name
        series = Series(sample / "robot.urdf", arm.names(), tip, campaign.readings[own], campaign.recorded.points[own])
        tree = data.model.tree
        compare_kinematics(series, tree, tree.links[tip], poses, repeats)
        compare_calibrations(series, calibrations(data, settings, steps), other_poses(campaign, 77), repeats)


def main() -> None:
    """Run in a process of its own with one processor."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--steps", type=int, help="most steps of scipy's least squares; absent: to the end")
    parser.add_argument("--threads", type=int, help="measure here with so many threads (used by the program itself)")
    options = parser.parse_args()
    if options.threads is None:
        given = ["--poses", str(options.poses), "--repeats", str(options.repeats)]
        given += ["--steps", str(options.steps)] if options.steps else []
        run_pinned("benchmarks.chains", given, 1)
        return
    pin(options.threads)
    measure(options.poses, options.repeats, options.steps)


if __name__ == "__main__":
    main()
