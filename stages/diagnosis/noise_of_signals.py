"""Noise of signals that nobody declared: their scatter about the final model, where causes were found in it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.model import BenchModel
from truing.stages.diagnosis.diagnosis_data import Channels, DiagnosisData

if TYPE_CHECKING:
    from truing.inference.observations import Epochs
    from truing.inference.selection import CauseDiagnosis

_NORMAL_MEDIAN = 0.6745
_UNKNOWNS = 7  # of a signal's linear response to six loads, and its zero
# Scatter about the final model over the first estimate, below which that held an effect: of a few dozen rows, either is
# uncertain by a tenth or two.
_SMALLER = 0.7


def with_noise_next_to_causes(diagnosis: CauseDiagnosis, data: DiagnosisData) -> DiagnosisData | None:
    """Return the data with the noise of each signal estimated again next to the causes found; None where no effect was
    in the first estimate, or the noise is declared."""
    final = diagnosis.final
    if not isinstance(data.shown, Channels) or data.shown.is_noise_known or not final.causes:
        return None
    if not diagnosis.end.is_complete:
        return None  # what remains holds effects
    assert isinstance(data.model, BenchModel)
    ratio = _smaller(diagnosis, data.model.known.sigma)
    if (ratio == 1.0).all():
        return None
    known = replace(data.model.known, sigma=data.model.known.sigma * ratio)
    held_out = None if data.held_out is None else _scaled(data.held_out, ratio)
    return replace(
        data,
        model=replace(data.model, known=known),
        calibration=_scaled(data.calibration, ratio),
        held_out=held_out,
    )


def _smaller(diagnosis: CauseDiagnosis, sigma: NDArray) -> NDArray:
    """Return the factor (K,) of each channel's noise ``sigma`` (K,); 1 where its first estimate held no effect."""
    final = diagnosis.final
    unknowns = _UNKNOWNS + sum(len(final.values(cause)[0]) for cause in final.causes)
    ratio = np.ones(len(sigma))
    for channel in range(len(sigma)):
        left = np.abs(final.error.gap[final.error.is_observed[:, channel], channel, 0])
        freedom = len(left) - unknowns
        if freedom > 0:
            ratio[channel] = np.median(left) / _NORMAL_MEDIAN * np.sqrt(len(left) / freedom) / sigma[channel]
    return np.where((ratio > 0.0) & (ratio < _SMALLER), ratio, 1.0)


def _scaled(epochs: Epochs, ratio: NDArray) -> Epochs:
    """Return epochs whose observations have noise times ``ratio`` (K,)."""
    measured = epochs.measured
    return replace(epochs, measured=replace(measured, covariance=measured.covariance * ratio[:, None, None] ** 2))
