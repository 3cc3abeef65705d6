"""A fully simulated bench: the compliance from its runs, and faults inserted into its log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import table
from tests.estimation.interferometry.bench import ALL_PAIRS, LEVELS, OWN_PAIRS, Log, made_log
from tests.simulation.bench.six_upur.sensors import sensor_of
from truing.estimation.interferometry import log_quality as quality
from truing.estimation.interferometry.compliance import Compliance, axis_curve, compare, fit_compliance
from truing.estimation.interferometry.jumps import find_slips
from truing.estimation.interferometry.load_run import PLAIN, RunFit, Term, fit_run, run_columns

LOADS, CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz"), ("dx", "dy", "dz", "rx", "ry", "rz")
STEP_S, SIGMA_M = 120.0, 0.5e-6
TIME_S = STEP_S * np.arange(len(LEVELS))
QUANTUM_M = 632.990577e-9 / 2.0
DRIFT_M_PER_H = 2e-6
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


def runs_table() -> str:
    """What more terms cost the response of one run, and what a drift does to it where none is fitted."""
    response = float(sensor_compliance()[2, 2])
    drift = DRIFT_M_PER_H / 3600.0 * TIME_S
    models: dict[str, tuple[Term, ...]] = {
        "zero, response": ("zero", "response"),
        "and drift": PLAIN,
        "and hysteresis": (*PLAIN, "hysteresis"),
        "and asymmetry, cubic": (*PLAIN, "hysteresis", "asymmetry", "cubic"),
    }
    rows = []
    for name, terms in models.items():
        fit = fit_run(response * LEVELS + drift, SIGMA_M, run_columns(LEVELS, TIME_S, terms), terms)
        value, sigma = fit.value("response")
        slipped = find_slips(np.zeros((1, len(LEVELS))), SIGMA_M, run_columns(LEVELS, TIME_S, terms), QUANTUM_M)
        reported = [f"{100 * sigma / response:.3f} %", f"{signed(100 * (value / response - 1), 3)} %"]
        rows.append([name, *reported, f"{slipped.detectable[0]:.0f}"])
    return table(["terms", "sigma of the response", "off by the drift", "fewest fringes that show"], rows)


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


def curves_table() -> str:
    """The largest deflections along each loaded axis, measured and simulated, as figures 12 to 17 of the paper."""
    log = eccentric_log()
    rows = []
    for axis, (load, channel) in enumerate(zip(LOADS, CHANNELS, strict=True)):
        unit, scale = ("um", 1e6) if axis < 3 else ("arcsec", 1.0 / ARCSEC)
        read = 2.0 * log.covariance  # a reading's own noise, and that of the zero
        curve = axis_curve(axis, log.wrench, log.displacement, read, sensor_compliance())
        worst = np.abs((curve.measured - curve.simulated) / curve.sigma).max()
        values = [curve.largest, curve.smallest, curve.simulated.max(), curve.simulated.min()]
        rows.append([load, channel, *(f"{scale * value:.2f}" for value in values), unit, f"{worst:.1f}"])
    heads = [
        "load",
        "channel",
        "measured +",
        "measured −",
        "simulated +",
        "simulated −",
        "unit",
        "largest \\|z\\| of a step",
    ]
    return table(heads, rows)


def quality_table() -> str:
    """Faults inserted into a good log of three runs of each kind, and the resulting messages."""
    log = made_log(np.random.default_rng(3), [*OWN_PAIRS] * 3, sensor_compliance())
    run, step = log.run, log.step
    kept = np.arange(len(run)) != 130
    pressed = np.clip(log.reading[:21], -1.5e-3, None)
    rows = [
        ["load of fz 12 kN, range 10 kN", *_reported(quality.loads_beyond(np.where(run == 2, 12e3, 9e3)[::21], 1e4))],
        ["sign of run 8 flipped", *_reported(quality.signs_flipped(*_slopes(_spoilt(log, 8, -1.0)), _kinds(log)))],
        ["run 4 in degrees for arcsec", *_units(_spoilt(log, 4, 1 / 3600.0))],
        ["run 13 in mm for um", *_units(_spoilt(log, 13, 1e-3))],
        ["a step of run 6 missing", *_reported(quality.steps_missing(run[kept], step[kept]), 1.0)],
        ["row 9 repeated as row 378, 5 um off", *_twice(log)],
        ["dx of run 0 held at −1500 um", *_reported(quality.saturated(pressed, LEVELS), 1e6)],
        ["jump of 8 um in run 14 from step 13 on", *_jump(log)],
        [
            "drift of 10 um/h in run 2, 6.7 um over it",
            *_reported(quality.drifting(_fits(_drifted(log)), TIME_S[-1]), 1e6),
        ],
        ["noise twice the declared", *_noise()],
    ]
    return table(["planted", "where", "how much"], rows)


def signed(value: float, digits: int) -> str:
    """A number with its sign; zero without."""
    reported = f"{value:+.{digits}f}"
    return reported if float(reported) else reported[1:]


def _probability(value: float) -> str:
    return f"{value:.2g}" if value > 1e-9 else "below 1e-9"


def _reported(found: quality.LogFaults, scale: float = 1.0) -> list[str]:
    where = ", ".join(str(at) for at in found.where[:6]) + (" ..." if len(found) > 6 else "")
    sizes = dict.fromkeys(f"{scale * size:.4g}" for size in found.size)
    return [where or "nowhere", ", ".join(sizes)]


def _spoilt(log: Log, run: int, factor: float) -> Log:
    reading = np.where(log.run == run, factor, 1.0) * log.reading
    return Log(log.wrench, log.channel, reading, log.sigma, log.run, log.step, log.axis, log.truth)


def _drifted(log: Log) -> Log:
    reading = log.reading + np.where(log.run == 2, 10e-6 / 3600.0 * STEP_S * (log.step - 1), 0.0)
    return Log(log.wrench, log.channel, reading, log.sigma, log.run, log.step, log.axis, log.truth)


def _fits(log: Log) -> list[RunFit]:
    columns = run_columns(LEVELS, TIME_S)
    rows = zip(log.reading.reshape(-1, len(LEVELS)), log.sigma.reshape(-1, len(LEVELS)), strict=True)
    return [fit_run(reading, sigma, columns, PLAIN) for reading, sigma in rows]


def _slopes(log: Log) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    value, sigma = np.array([fit.value("response") for fit in _fits(log)]).T
    return value, sigma


def _kinds(log: Log) -> NDArray[np.int64]:
    return np.asarray(6 * log.axis + log.channel)[:: len(LEVELS)]


def _units(log: Log) -> list[str]:
    value, sigma = _slopes(log)
    own_sigma = sigma * [fit.noise_ratio for fit in _fits(log)]
    expected = np.diag(sensor_compliance())[log.axis[:: len(LEVELS)]]
    return _reported(quality.units_mistaken(value, own_sigma, expected))


def _twice(log: Log) -> list[str]:
    run, step, channel = (np.append(values, values[9]) for values in (log.run, log.step, log.channel))
    return _reported(quality.channels_twice(run, step, channel, np.append(log.reading, log.reading[9] + 5e-6)), 1e6)


def _jump(log: Log) -> list[str]:
    reading = log.reading.reshape(-1, len(LEVELS)).copy()
    reading[14, 12:] += 8e-6
    found = quality.jumps(reading, log.sigma.reshape(-1, len(LEVELS)), run_columns(LEVELS, TIME_S))
    reported = zip(found.where, found.onset, found.size, strict=True)
    return ["; ".join(f"{run} from step {onset + 1}" for run, onset, _ in reported), f"{1e6 * found.size[0]:.1f}"]


def _noise() -> list[str]:
    log = made_log(np.random.default_rng(4), [*OWN_PAIRS] * 3, sensor_compliance(), noise=2.0)
    declared = Log(log.wrench, log.channel, log.reading, 0.5 * log.sigma, log.run, log.step, log.axis, log.truth)
    scatter = quality.noise_of_runs(_fits(declared))
    whole = np.sqrt(scatter.chi_square.sum() / scatter.dof.sum())
    return [f"{(scatter.p_above(1.0) < 0.01 / 18).sum()} of 18 runs", f"{whole:.2f} times"]
