"""Tables of docs/force-sensor-paper.md on tolerances: the share of each source, and the uncertainty of a hundred
samples."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from docs.experiments.force_sensor_sets import ARCSEC, SETS, published, sigmas, three_fold
from docs.experiments.force_sensor_statics import twists_of
from docs.experiments.marked_tables import table
from truing.simulation.bench.six_upur.assembly import CODES, SOURCES, closed_loop_map, comprehensive, open_chain_map
from truing.simulation.bench.six_upur.geometry import JointCentres
from truing.simulation.bench.six_upur.influence import influence_matrix, merit
from truing.simulation.bench.six_upur.tolerances import (
    box_muller,
    first_order_covariances,
    rms_band,
    rms_scatter,
    sampled_errors,
)

SAMPLES, EXPERIMENTS, MANY = 100, 2000, 100_000


@cache
def geometries() -> dict[str, JointCentres]:
    """Return the sensors whose closed loops are compared: the printed cond(G) at both twists, and set A."""
    small, large = twists_of(published().condition.G)
    pairs = {f"twist {twist:.1f}°": three_fold(20.0, 20.0 + twist).joints() for twist in (small, 20.0, large)}
    return {**pairs, "set A": SETS["A"].joints()}


def sources() -> str:
    """Return the rms of each source by the paper's average of open chains, and by closed loops."""
    T, sigma = published().tolerances.full_width_um, sigmas()
    opened = _rms(open_chain_map(geometries()["set A"]), sigma)
    closed = [_rms(closed_loop_map(joints), sigma) for joints in geometries().values()]
    rows = []
    for k, code in enumerate(CODES):
        cells = [code, SOURCES[k].replace("_", " "), str(T[k]), f"{1e6 * sigma[k]:.1f}"]
        cells += [f"{1e6 * opened[0][k]:.1f}, {opened[1][k] / ARCSEC:.0f}"]
        rows.append([*cells, *(f"{1e6 * found[0][k]:.1f}, {found[1][k] / ARCSEC:.1f}" for found in closed)])
    head = ["", "source", "T, µm", "σ, µm", "open chains (eq. 14)", *(f"closed, {name}" for name in geometries())]
    return table(head, rows)


def leaders() -> str:
    """Return the rms of REM (platform's radius) and IES (sensor's installation), by the twist of three-fold legs."""
    rows = []
    for twist in (9.0, 20.0, 40.0, 60.0, 70.0, 75.0, 80.0, 85.8):
        joints = three_fold(20.0, 20.0 + twist).joints()
        position, attitude = _rms(closed_loop_map(joints), sigmas())
        condition = float(merit(influence_matrix(joints)).condition)
        pairs = [
            f"{scale * rms[0]:.1f} : {scale * rms[4]:.1f}" for scale, rms in ((1e6, position), (1 / ARCSEC, attitude))
        ]
        rows.append([f"{twist:.1f}", f"{condition:.2f}", *pairs])
    return table(["twist, °", "cond(G), m", "REM : IES, position, µm", "REM : IES, attitude, arcsec"], rows)


def _rms(error_map: NDArray, sigma: NDArray) -> tuple[NDArray, NDArray]:
    C = first_order_covariances(error_map, sigma)
    position, attitude = (np.trace(C[:, part, part], axis1=1, axis2=2) for part in (slice(3), slice(3, 6)))
    return np.sqrt(position), np.sqrt(attitude)


def sampling() -> str:
    """Return for each source the rms to first order, of a hundred samples and of many, with their bands."""
    joints, sigma = geometries()["twist 9.0°"], sigmas()
    C = first_order_covariances(closed_loop_map(joints), sigma)
    rows = []
    for k, code in enumerate(CODES):
        only = np.where(np.arange(5) == k, sigma, 0.0)
        few, many = (sampled_errors(joints, only, n, np.random.default_rng(k)) for n in (SAMPLES, MANY))
        for kind, (name, unit) in enumerate((("position, µm", 1e6), ("attitude, arcsec", 1 / ARCSEC))):
            block = C[k, 3 * kind : 3 * kind + 3, 3 * kind : 3 * kind + 3]
            found = [_band(unit * comprehensive(errors)[kind], d) for errors, d in ((few, 2), (many, 3))]
            scatter = f"{100 * float(rms_scatter(block, SAMPLES)):.1f} %"
            rows.append([code, name, f"{unit * np.sqrt(np.trace(block)):.3f}", *found, scatter])
    head = ["", "rms", "first order", f"{SAMPLES} samples (95 %)", f"{MANY:,} samples (95 %)"]
    return table([*head, f"scatter of {SAMPLES}"], rows)


def _band(norms: NDArray, digits: int) -> str:
    band = rms_band(norms)
    return f"{band.value:.{digits}f} ({band.low:.{digits}f} to {band.high:.{digits}f})"


def ranking() -> str:
    """Return the share of experiments of a hundred samples that rank the sources correctly.

    Also the 95 % range of the ratio of two equal sources (ECU over ECP), and the samples that separate REM from REF.
    """
    rows = []
    for name, joints in geometries().items():
        means = experiment_means(name)
        for kind, what in enumerate(("position", "attitude")):
            found = means[:, kind]
            low, high = np.quantile(found[:, 3] / found[:, 2], [0.025, 0.975])
            cells = [f"{100 * right_order(found):.0f} %", f"{low:.2f} to {high:.2f}", f"{needed(joints, kind):,}"]
            rows.append([name, what, *cells])
    head = ["closed loops", "error", f"order of {SAMPLES}-sample means right", "ECU over ECP, 95 % of experiments"]
    return table([*head, "samples that tell REM from REF"], rows)


@cache
def experiment_means(name: str) -> NDArray:
    """Return means of the comprehensive errors (EXPERIMENTS, 2, 5) of experiments of SAMPLES draws per source."""
    rng, by_source = np.random.default_rng(0), closed_loop_map(geometries()[name])
    means = np.empty((EXPERIMENTS, 2, 5))
    for k, sigma in enumerate(sigmas()):
        size = EXPERIMENTS * SAMPLES
        errors = box_muller(sigma, 1.0 - rng.random((size, 6)), rng.random((size, 6))) @ by_source[..., k].T
        for kind, norms in enumerate(comprehensive(errors)):
            means[:, kind, k] = norms.reshape(EXPERIMENTS, SAMPLES).mean(1)
    return means


def right_order(means: NDArray) -> float:
    """Return the share of experiments (n, 5) that rank REM, REF, ECP with ECU, and IES as all of them together do."""
    expected = means.mean(0)
    apart = [(i, k) for i in range(5) for k in range(i) if {i, k} != {2, 3}]
    agree = [(means[:, i] > means[:, k]) == (expected[i] > expected[k]) for i, k in apart]
    return float(np.mean(np.all(agree, axis=0)))


def needed(joints: JointCentres, kind: int) -> int:
    """Return the samples of each source that separate the rms of REM from that of REF by two sigma."""
    part = slice(3 * kind, 3 * kind + 3)
    C = first_order_covariances(closed_loop_map(joints), sigmas())[:2, part, part]
    rms = np.sqrt(np.trace(C, axis1=1, axis2=2))
    scatter = rms_scatter(C, 1) * rms
    return int(np.ceil(4.0 * np.sum(scatter**2) / (rms[0] - rms[1]) ** 2))
