"""Exponential settling with one time constant: its course over a finite interval, and its reported constant."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import ReportedParameter


def settling(passed: NDArray, rate: NDArray | complex) -> tuple[NDArray, NDArray]:
    """Return the course (1 - exp(-rate x)) / (1 - exp(-rate)), (B,), and its derivative by the log of its time
    constant.

    passed: x (B,), 0 at the start and 1 at the end; rate: length of the interval over the time constant.
    """
    total = -np.expm1(-rate)
    value = -np.expm1(-rate * passed) / total
    by_rate = (passed * np.exp(-rate * passed) - value * np.exp(-rate)) / total
    return value, -rate * by_rate


def reported_time_constant(tau_s: float, log_ratio: float, variance: float) -> ReportedParameter:
    """Return the time constant in s: ``tau_s`` times the exponential of a fitted logarithm with its variance."""
    tau = tau_s * float(np.exp(log_ratio))
    return ReportedParameter("tau", tau, tau * float(np.sqrt(variance)), "s")
