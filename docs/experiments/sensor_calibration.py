"""Tables of docs/sensor-calibration.md: accuracy of each calibration of a force sensor on a simulated bench.

    python -m docs.experiments.sensor_calibration

renews them (about a minute).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import renew, table
from docs.experiments.sensor_bench import (
    LEG_LIMIT_N,
    RANGE,
    SIGNAL_MV,
    Bench,
    along_rays,
    eight_channels,
    influence,
    single_axis,
    six_channels,
)
from truing.estimation.sensor.calibrate import UndeterminedCalibrationError, fit_calibration
from truing.estimation.sensor.calibration import CalibrationModel, calibration_matrix, wrenches
from truing.estimation.sensor.contenders import choose_calibration, covariance_by_case
from truing.estimation.sensor.exchanged_loads import exchanged_loads
from truing.estimation.sensor.load_cases import (
    LoadLimits,
    bench_loads,
    choose_loads,
    corner_loads,
    load_efficiency,
    predicted_sigma,
)
from truing.estimation.sensor.load_table import LoadTable, load_table

PAGE = Path(__file__).resolve().parents[1] / "sensor-calibration.md"
DRAWS = 40
BOTH = CalibrationModel("errors in both")
FORWARD = replace(BOTH, direction="forward")

# In words: noise of signals, mV, and of loads, share of the range; whether some runs were loaded less surely.
SCENARIOS: dict[str, tuple[float, float, bool]] = {
    "signals to 0.01 mV, loads to 0.1 % of the range": (SIGNAL_MV, 1e-3, False),
    "every other run loaded to 1 % only": (SIGNAL_MV, 1e-3, True),
    "signals to 0.2 mV": (0.2, 1e-3, False),
}
ESTIMATORS = {
    "least squares, as printed": CalibrationModel(),
    "weighted": CalibrationModel("weighted"),
    "errors in both": BOTH,
}


def fresh_loads(rng: np.random.Generator, count: int = 200) -> NDArray:
    """Return loads (N, 6) anywhere within the range."""
    return rng.uniform(-1.0, 1.0, (count, 6)) * RANGE


def _table(bench: Bench, rng: np.random.Generator, uneven: bool) -> LoadTable:
    loads, case = along_rays(rng)
    made = bench.recorded(rng, loads, case)
    if not uneven:
        return made
    size = np.where(case % 2, 10.0, 1.0)
    cov = size[:, None, None] ** 2 * bench.load_cov
    return replace(made, loads=loads + (made.loads - loads) * size[:, None], load_cov=cov)


def estimator_errors(scenario: str, draws: int) -> dict[str, tuple[float, float]]:
    """Return each estimator's rms wrench error at fresh loads without noise, in 1e-4 of the range, and rms pull."""
    signal, load, uneven = SCENARIOS[scenario]
    bench = six_channels(signal_mv=signal, load_share=load)
    errors: dict[str, list[tuple[float, float]]] = {name: [] for name in ESTIMATORS}
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        made, fresh = _table(bench, rng, uneven), fresh_loads(rng)
        for name, model in ESTIMATORS.items():
            found = calibration_matrix(fit_calibration(made, model))
            miss = (fresh @ bench.A.T @ found.value.T - fresh) / RANGE
            pull = (found.value - np.linalg.inv(bench.A)) / found.sigma
            errors[name].append((float(np.mean(miss**2)), float(np.mean(pull**2))))
    return {name: (1e4 * _root(rows, 0), _root(rows, 1)) for name, rows in errors.items()}


def _root(rows: list[tuple[float, float]], column: int) -> float:
    return float(np.sqrt(np.mean([row[column] for row in rows])))


def estimators() -> str:
    """The table of estimators."""
    rows = []
    for scenario in SCENARIOS:
        found = estimator_errors(scenario, DRAWS)
        rows.append([scenario, *(f"{error:.1f} ({pull:.1f})" for error, pull in found.values())])
    return table(["", *ESTIMATORS], rows)


CHANNELS: dict[str, tuple[Callable[..., Bench], CalibrationModel]] = {
    "six, as printed": (six_channels, CalibrationModel()),
    "six, errors in both": (six_channels, BOTH),
    "eight, V Vᵀ inverted all the same": (eight_channels, CalibrationModel()),
    "eight, least squares with a prior (ridge)": (eight_channels, CalibrationModel(ridge=1.0)),
    "eight, signals from loads, errors in both": (eight_channels, FORWARD),
}


def channel_errors(name: str, draws: int) -> tuple[float, float]:
    """Return the rms error of wrenches from noisy signals, in 1e-4 of the range, and the scatter of G_B, N/mV.

    The scatter is that of the entries between campaigns of the same loads with fresh noise.
    """
    make, model = CHANNELS[name]
    bench = make(signal_mv=0.05)
    loads, case = along_rays(np.random.default_rng(0))
    errors, matrices = [], []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        made = bench.recorded(rng, loads, case)
        undeclared = model.estimator == "least squares"  # or the check of V V^T would refuse noise for a signal
        fit = fit_calibration(replace(made, signal_cov=None) if undeclared else made, model)
        fresh = fresh_loads(rng)
        signals = fresh @ bench.A.T
        signals = signals + bench.signal_mv * rng.normal(size=signals.shape)
        found = wrenches(fit, signals, np.empty((len(signals), 0)), bench.signal_cov).value
        errors.append(float(np.mean(((found - fresh) / RANGE) ** 2)))
        matrices.append(calibration_matrix(fit, bench.signal_cov).value)
    scatter = np.std(matrices, axis=0, ddof=1)
    return 1e4 * float(np.sqrt(np.mean(errors))), float(np.sqrt(np.mean(scatter**2)))


def channels() -> str:
    """The table of six and eight channels."""
    rows = []
    for name in CHANNELS:
        error, scatter = channel_errors(name, DRAWS)
        rows.append([name, f"{error:.1f}", f"{scatter:.1f}"])
    return table(["channels and estimator", "wrench error, 10⁻⁴ of the range", "scatter of G_B, N/mV"], rows)


SHARED = (0.0, 2e-3, 5e-3)


def shared_pulls(share: float, draws: int) -> tuple[float, float]:
    """Return rms pulls of the entries of G_B by the covariance of the fit, and by that from case to case.

    share: of the range, the error that all loads of a run have in common.
    """
    bench, pulls = six_channels(), []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        loads, case = along_rays(rng)
        made = bench.recorded(rng, loads, case)
        made = replace(made, loads=made.loads + share * RANGE * rng.normal(size=(24, 6))[case])
        fit = calibration_matrix(fit_calibration(made))
        miss = fit.value - np.linalg.inv(bench.A)
        by_case = covariance_by_case(made, CalibrationModel())
        pulls.append((float(np.mean((miss / fit.sigma) ** 2)), float(np.mean((miss / by_case.sigma) ** 2))))
    return _root(pulls, 0), _root(pulls, 1)


def shared() -> str:
    """The table of pulls."""
    rows = []
    for share in SHARED:
        words = f"an error of {100 * share:g} % of the range" if share else "nothing"
        rows.append([words, *(f"{pull:.1f}" for pull in shared_pulls(share, DRAWS))])
    return table(["loads of a run share", "pulls by the fit", "pulls by cases"], rows)


MISSING: dict[str, Callable[[NDArray, NDArray], tuple[NDArray, NDArray]]] = {
    "no torque about z": lambda loads, A: ((loads * (np.arange(6) != 5)) @ A.T, loads * (np.arange(6) != 5)),
    "the force along y at an arm of 0.15 m, always": lambda loads, A: (_armed(loads) @ A.T, _armed(loads)),
    "channel 7 repeats channel 3": lambda loads, A: (np.column_stack([loads @ A.T, (loads @ A.T)[:, 2]]), loads),
    "channel 4 is dead": lambda loads, A: ((loads @ A.T) * (np.arange(6) != 3), loads),
}


def _armed(loads: NDArray) -> NDArray:
    return np.column_stack([loads[:, :3], -0.15 * loads[:, 1], loads[:, 4:]])


def missing_words(name: str) -> str:
    """Return the message on a bench that does not determine the calibration."""
    loads, _ = along_rays(np.random.default_rng(0))
    try:
        fit_calibration(load_table(*MISSING[name](loads, six_channels().A)))
    except UndeterminedCalibrationError as error:
        return str(error)
    raise ValueError(f"{name} determines everything")


def missing() -> str:
    """The table of errors."""
    return table(["what was done", "what is said"], [[name, missing_words(name)] for name in MISSING])


CONTENDERS = {
    "linear": FORWARD,
    "with a zero": replace(FORWARD, zero="common"),
    "with zero and temperature": replace(FORWARD, zero="common", drift=True),
    "with zero and squares": replace(FORWARD, zero="common", powers="squares"),
}
# What is in the signals next to the linear part: a zero, mV; drift, mV/K at +-3 K; bend, mV at full load.
TRUTHS: dict[str, tuple[float, float, float]] = {
    "nothing but the linear part": (0.0, 0.0, 0.0),
    "a zero of 0.1 mV": (0.1, 0.0, 0.0),
    "a zero, and 0.02 mV/K": (0.1, 0.02, 0.0),
    "a zero, and a bend of 0.002 mV": (0.1, 0.0, 0.002),
    "a zero, and a bend of 0.02 mV": (0.1, 0.0, 0.02),
}


def chosen(truth: str, draws: int) -> NDArray:
    """Return the number of draws in which held-out load cases choose each contender."""
    zero, drift, bend = TRUTHS[truth]
    bench, counts = six_channels(), np.zeros(len(CONTENDERS), int)
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        loads, case = along_rays(rng)
        warm = rng.uniform(-3.0, 3.0, len(np.unique(case)))[case]
        more = zero + drift * warm[:, None] + bend * (loads / RANGE) ** 2 @ rng.normal(size=(6, 6))
        made = bench.recorded(rng, loads, case, more)
        made = replace(made, covariates=warm[:, None], covariate_names=("dT",))
        counts[choose_calibration(made, list(CONTENDERS.values())).choice.chosen] += 1
    return counts


def choice() -> str:
    """The table of choices."""
    rows = [[truth, *(str(n) for n in chosen(truth, DRAWS // 4))] for truth in TRUTHS]
    return table([f"in the signals ({DRAWS // 4} campaigns each)", *CONTENDERS], rows)


def by_heart(cases: bool) -> tuple[list[float], int]:
    """Return held-out errors, shares of the range, of a linear and a full quadratic calibration, and which is chosen.

    The sensor stood in 40 poses, five readings each, with 0.5 mV of its own in each; held out are poses or rows.
    """
    rng, bench = np.random.default_rng(0), six_channels(signal_mv=1e-3, load_share=1e-6)
    loads, again = fresh_loads(rng, 40), np.repeat(np.arange(40), 5)
    made = bench.recorded(rng, loads[again], again, 0.5 * rng.normal(size=(40, 6))[again])
    made = replace(made, signal_cov=None, load_cov=None)
    if not cases:
        made = replace(made, case=rng.permutation(200) % 40)
    both = choose_calibration(made, [CalibrationModel(), CalibrationModel(powers="products")])
    errors = [float(np.sqrt(np.mean((contender.errors / RANGE) ** 2))) for contender in both.contenders]
    return errors, both.choice.chosen


def heart() -> str:
    """The table of splits."""
    rows = []
    for name, cases in (("rows, at random", False), ("poses, whole", True)):
        (linear, quadratic), taken = by_heart(cases)
        rows.append([name, f"{100 * linear:.1f} %", f"{100 * quadratic:.1f} %", ("linear", "quadratic")[taken]])
    return table(["held out", "linear, 6 terms", "quadratic, 27 terms", "chosen"], rows)


LIMITS = LoadLimits(RANGE)
WITH_LEGS = LoadLimits(RANGE, np.linalg.inv(influence()), np.full(6, LEG_LIMIT_N))
STEPS = 120


def plans() -> dict[str, NDArray]:
    """Return the loads (120, 6) of every plan, none beyond what a leg bears."""
    rng, full = np.random.default_rng(0), np.array([1.0])
    return {
        "one axis at a time, steps of Table 3": single_axis()[0],
        "one axis at a time, always at full load": choose_loads(
            bench_loads(WITH_LEGS, full, 1), STEPS, WITH_LEGS, rng=rng
        ).loads,
        "two axes at once": choose_loads(bench_loads(WITH_LEGS, full, 2), STEPS, WITH_LEGS, rng=rng).loads,
        "three axes at once": choose_loads(bench_loads(WITH_LEGS, full, 3), STEPS, WITH_LEGS, rng=rng).loads,
        "any, no leg beyond its cell's 2 t": choose_loads(corner_loads(WITH_LEGS), STEPS, WITH_LEGS, rng=rng).loads,
    }


def judged(loads: NDArray) -> tuple[float, float]:
    """Return the D-efficiency of loads relative to the best within the legs' limits, and the rms predicted sigma of a
    sensitivity times its range, µV."""
    share = load_efficiency(loads, corner_loads(WITH_LEGS), WITH_LEGS).efficiency
    sigma = predicted_sigma(loads, np.full(6, SIGNAL_MV), WITH_LEGS) * RANGE
    return share, 1e3 * float(np.sqrt(np.mean(sigma**2)))


def loading() -> str:
    """The table of plans."""
    rows = []
    for name, loads in plans().items():
        share, sigma = judged(loads)
        rows.append([name, f"{100 * share:.0f} %", f"{sigma:.2f}"])
    return table(["120 load steps", "D-efficiency", "sigma of a sensitivity at full load, µV"], rows)


def exchanged(share: float, draws: int) -> tuple[int, int]:
    """Return two numbers of draws: with the exchanged rows named, and with any other pair named.

    share: difference of the two rows' loads in one component, as a share of the range; 0 exchanges nothing.
    """
    bench, named, else_named = six_channels(), 0, 0
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        loads, case = along_rays(rng)
        axis = int(rng.integers(6))
        gap = np.abs(loads[:, None, axis] - loads[None, :, axis]) / RANGE[axis]
        first, second = np.unravel_index(np.argmin(np.abs(gap - share) + np.tri(len(loads))), gap.shape)
        made = bench.recorded(rng, loads, case)
        written = made.loads.copy()
        written[[first, second], axis] = written[[second, first], axis]
        pairs = [
            (one.first, one.second) for one in exchanged_loads(replace(made, loads=written if share else made.loads))
        ]
        hidden = {(int(first), int(second))} if share else set()
        named += bool(hidden & set(pairs))
        else_named += bool(set(pairs) - hidden)
    return named, else_named


SHARES = (0.0, 0.003, 0.005, 0.01, 0.02, 0.1)


def rows() -> str:
    """The table of exchanged rows."""
    lines = []
    for share in SHARES:
        named, wrong = exchanged(share, DRAWS)
        words = f"{100 * share:g} % of the range" if share else "nothing exchanged"
        lines.append([words, str(DRAWS), str(named) if share else "", str(wrong)])
    return table(["the two loads differ by", "tables", "named", "others named"], lines)


TABLES: dict[str, Callable[[], str]] = {
    "estimators": estimators,
    "channels": channels,
    "shared": shared,
    "missing": missing,
    "choice": choice,
    "heart": heart,
    "loading": loading,
    "rows": rows,
}

if __name__ == "__main__":
    renew(PAGE, TABLES)
