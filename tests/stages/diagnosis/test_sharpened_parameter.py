"""The next measurement improves a parameter that the model fits, not a derived one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from truing.simulation.cause import ReportedParameter
from truing.stages.diagnosis.next_measurement import _largest


class OpenPitch:
    """A wave of which the readings leave the pitch open: its value does not depend on the amplitudes."""

    key = "wave"

    def reported(self, values: np.ndarray, covariance: np.ndarray, legs: int) -> tuple[ReportedParameter, ...]:
        amplitude, sigma = float(np.hypot(*values)), float(np.sqrt(covariance[0, 0]))
        return ReportedParameter("amplitude", amplitude, sigma, "mm"), ReportedParameter("pitch", 1.2, 1.2, "mm")


def fitted() -> Any:
    """Stand in for a fitted model with two amplitudes."""
    model = SimpleNamespace(
        layout={"wave": slice(1, 3)}, part_count=6, effect_sigma=lambda cause: np.array([1e-3, 1e-3])
    )
    return SimpleNamespace(model=model, shared=np.array([0.0, 3.0, 4.0]), covariance=np.eye(3))


def test_a_pitch_that_the_readings_leave_open_is_not_sharpened() -> None:
    for least_known in (False, True):
        chosen = _largest(OpenPitch(), fitted(), least_known)
        assert chosen is not None
        assert chosen.name == "amplitude"
        assert np.abs(chosen.direction - 1e-3 * np.array([0.0, 0.6, 0.8])).max() < 1e-9
