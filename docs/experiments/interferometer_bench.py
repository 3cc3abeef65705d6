"""Compliance of a simulated bench from its runs, for docs/interferometer.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import table
from tests.estimation.interferometry.bench import ALL_PAIRS, OWN_PAIRS, Log, made_log
from tests.simulation.bench.six_upur.sensors import sensor_of
from truing.estimation.interferometry.compliance import Compliance, compare, fit_compliance

LOADS, CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz"), ("dx", "dy", "dz", "rx", "ry", "rz")
OFFSET_M = np.array([0.0, 0.02, 0.0])  # of the z load's line of action
ARCSEC = np.pi / 180.0 / 3600.0


def sensor_compliance() -> NDArray[np.float64]:
    """The simulated compliance (6, 6) of a sensor that meets the published deformations."""
    return np.asarray(sensor_of("A").compliance)


def with_eccentric_load() -> NDArray[np.float64]:
    """Response of the bench to nominal loads with an eccentric z load."""
    brought = np.eye(6)
    brought[3:, 2] = np.cross(OFFSET_M, [0.0, 0.0, 1.0])
    return sensor_compliance() @ brought


def fitted(log: Log) -> Compliance:
    """The matrix compliance of a log."""
    return fit_compliance(log.wrench, log.displacement, log.covariance, log.run)


def compliance_table() -> str:
    """Entries of the compliance that six runs, and thirty-six runs, determine."""
    rows = []
    for name, pairs in (
        ("each axis its own channel, 6 runs", OWN_PAIRS),
        ("each axis all channels, 36 runs", ALL_PAIRS),
    ):
        found = fitted(made_log(np.random.default_rng(1), pairs, sensor_compliance()))
        own, other = (compare(found, C) for C in (sensor_compliance(), with_eccentric_load()))
        sure = np.diag(found.sigma) / np.diag(sensor_compliance())
        reported = [f"{found.known.sum()} of 36", f"{100 * sure.min():.3f} to {100 * sure.max():.3f} %"]
        rows.append([name, *reported, _probability(own.p_value), _probability(other.p_value)])
    heads = [
        "runs",
        "entries known",
        "sigma of the diagonal",
        "p, same as simulated",
        "p, same as with the z load 20 mm off",
    ]
    return table(heads, rows)


def entries_table() -> str:
    """z of each entry, of a log whose z load is 20 mm off the origin."""
    z = compare(fitted(eccentric_log()), sensor_compliance()).z
    return table(
        ["", *LOADS], [[name, *(signed(value, 1) for value in row)] for name, row in zip(CHANNELS, z, strict=True)]
    )


def eccentric_log() -> Log:
    """A log of all runs on the bench with a z load 20 mm off the origin."""
    return made_log(np.random.default_rng(2), ALL_PAIRS, with_eccentric_load())


def signed(value: float, digits: int) -> str:
    """A number with its sign; zero without."""
    reported = f"{value:+.{digits}f}"
    return reported if float(reported) else reported[1:]


def _probability(value: float) -> str:
    return f"{value:.2g}" if value > 1e-9 else "below 1e-9"
