"""Error classes recovered from a simulated loading series, and the force-sensor paper's relative errors.

    python -m docs.experiments.sensor_errors

renews the tables of docs/error-classes.md.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import renew, table
from truing.estimation.sensor.calibration import Figures, relative_errors
from truing.estimation.sensor.error_classes import AxisSeries, ErrorClass, creep, error_classes

PAGE = Path(__file__).resolve().parents[1] / "error-classes.md"
AXIS, FULL_N, SIGMA_N = 2, 9000.0, 2.0
ONCE = np.array([0.0, 1, 3, 5, 7, 9, 7, 5, 3, 1, 0]) * 1e3
LOAD = np.concatenate([ONCE, -ONCE] * 3)
CYCLE = np.repeat(np.arange(6), len(ONCE))
DRAWS = 1000


def series(rng: np.random.Generator, reading: NDArray) -> AxisSeries:
    """Return readings (N, 6) of the z axis with noise, and a zero of its own in every cycle."""
    zeros = 50.0 * rng.normal(size=(6, 6))[CYCLE]
    noisy = reading + zeros + SIGMA_N * rng.normal(size=reading.shape)
    return AxisSeries(LOAD, noisy, AXIS, CYCLE, np.full(6, SIGMA_N), np.full(6, FULL_N))


def _along_z(more: NDArray) -> NDArray:
    reading = np.zeros((len(LOAD), 6))
    reading[:, AXIS] = LOAD + more
    return reading


SHARE = LOAD / FULL_N
FALLING = ~series(np.random.default_rng(0), _along_z(np.zeros(len(LOAD)))).is_loading
LAST = np.tile(np.arange(len(ONCE)) == len(ONCE) - 1, 6)


def _line_left() -> float:
    """Return the largest residual of F |F| from its best line through zero at the five levels, F over the range."""
    share = np.array([1.0, 3, 5, 7, 9]) / 9
    return float(np.abs(share**2 - share * (share @ share**2) / (share @ share)).max())


# What is put in, in words; the class that has to show it, and its size as a share of the range; the readings (N, 6).
PLANTED: dict[str, tuple[str, int, float, NDArray]] = {
    "0.4 % F abs(F) / F_max": (
        "nonlinearity",
        AXIS,
        0.004 * _line_left(),
        _along_z(0.004 * FULL_N * SHARE * abs(SHARE)),
    ),
    "a loop, 0.3 % wide at half load": (
        "hysteresis",
        AXIS,
        0.003 * 4 * 5 / 9 * 4 / 9,
        _along_z(0.003 * FULL_N * 4 * SHARE * (1 - abs(SHARE)) * FALLING),
    ),
    "0.2 % left after every cycle": ("zero return", AXIS, 0.002, _along_z(0.002 * FULL_N * LAST)),
    "one cycle of six 0.2 % steeper": ("repeatability", AXIS, 0.002, _along_z(0.002 * FULL_N * SHARE * (CYCLE == 4))),
    "x shows 1 % of z": (
        "crosstalk",
        0,
        0.01,
        _along_z(np.zeros(len(LOAD))) + 0.01 * LOAD[:, None] * (np.arange(6) == 0),
    ),
}


def found(name: str) -> ErrorClass:
    """Return the class that has to show what was put in."""
    kind, component, _, reading = PLANTED[name]
    classes = error_classes(series(np.random.default_rng(1), reading))
    return next(one for one in classes if (one.name, one.component) == (kind, component))


def crept() -> ErrorClass:
    """Return the creep of 0.2 % with a time constant of 60 s, read every 10 s."""
    time = np.arange(0.0, 301.0, 10.0)
    reading = FULL_N * (1.0 + 2e-3 * (1 - np.exp(-time / 60.0)))
    noisy = reading + SIGMA_N * np.random.default_rng(2).normal(size=len(time))
    return creep(time, noisy, SIGMA_N, FULL_N)


def planted() -> str:
    """The table of what was put in and what was found, in per cent of the range."""
    rows = [[name, PLANTED[name][0], PLANTED[name][2], found(name)] for name in PLANTED]
    rows.append(["0.2 % with a time constant of 60 s", "creep", 2e-3 * (np.exp(-0.5) - np.exp(-5.0)), crept()])
    lines = [
        [words, kind, f"{100 * size:.3f}", f"{100 * one.value:.3f} ± {100 * one.sigma:.3f}", f"{100 * one.limit:.3f}"]
        for words, kind, size, one in rows
    ]
    return table(["put in", "class", "true", "found", "limit of noise alone"], lines)


def exceeded(draws: int) -> dict[str, float]:
    """Return the rate at which a sensor without errors exceeds the limit of each class."""
    rng, counts = np.random.default_rng(3), {}
    for _ in range(draws):
        for one in error_classes(series(rng, _along_z(np.zeros(len(LOAD))))):
            if one.component in (1, AXIS):
                counts[one.name] = counts.get(one.name, 0) + (one.value > one.limit)
    return {name: count / draws for name, count in counts.items()}


def silent() -> str:
    """The table of false alarms."""
    return table(
        ["class", f"limit exceeded by noise alone, of {DRAWS}"],
        [[k, f"{100 * v:.1f} %"] for k, v in exceeded(DRAWS).items()],
    )


COMPONENTS = ("S_Fx", "S_Fy", "S_Fz", "S_Mx", "S_My", "S_Mz")
# Force-sensor paper, Table 4 (rows J, J', J_B') and Table 5, per cent.
J = np.array([0.2964, 0.5472, 0.5473, 1.5025, 1.3973, 1.3974])
J_PRIME = np.array([1.0459, 0.8465, 0.9009, 6.8417, 3.7478, 6.0042])
J_MEASURED = np.array([1.4205, 0.9930, 1.8518, 8.2074, 3.2378, 6.9202])
PRINTED = {"Type 1": (26.37, 14.75, 51.35, 16.64, 15.75, 13.24), "Type 2": (79.13, 44.89, 70.44, 81.69, 56.84, 79.81)}
CONDITIONS, CONDITION_MEASURED, CONDITIONS_PRINTED = (11.7549, 6.3336), 10.7808, (9.03, 41.25)


def types() -> str:
    """The table of both types of error."""
    measured = Figures(J_MEASURED, np.zeros(6))
    errors = {"Type 1": relative_errors(J_PRIME, measured), "Type 2": relative_errors(J, measured)}
    rows = [
        [
            name,
            *(
                f"{100 * value:.3f} ({printed:g})"
                for value, printed in zip(errors[name].value, PRINTED[name], strict=True)
            ),
        ]
        for name in PRINTED
    ]
    condition = relative_errors(np.array(CONDITIONS), Figures(np.full(2, CONDITION_MEASURED), np.zeros(2))).value
    pairs = zip(rows, condition, CONDITIONS_PRINTED, strict=True)
    lines = [[*row, f"{100 * value:.3f} ({printed:g})"] for row, value, printed in pairs]
    return table(["per cent (printed)", *COMPONENTS, "cond"], lines)


TABLES: dict[str, Callable[[], str]] = {"planted": planted, "silent": silent, "types": types}

if __name__ == "__main__":
    renew(PAGE, TABLES)
