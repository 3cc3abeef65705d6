"""Sets of inputs on which residuals depend, compared by marginal likelihood.

Residuals are noise plus a Gaussian process of some inputs. All sets of one and two inputs compete, and sets of three
that contain a probable pair. An input is named if it belongs to the right set with high probability. A set of several
inputs may therefore be named in part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from typing import TypeAlias

import numpy as np

from truing.inference.arrays import Array
from truing.inference.input_spectra import Spectra, Spectrum
from truing.inference.random_functions import centred

_MOST_INPUTS = 3  # of a set
Inputs: TypeAlias = tuple[str, ...]  # names of a set of inputs

_PROBABLE_PAIRS = 6  # pairs to which third inputs are added
INCLUDED = 0.9  # probability from which on an input is named
_MOST_SETS = 3  # sets of inputs that are named in turn
_MOST_HELD = 0.5  # largest number of functions held fixed, as a share of the epochs
_LEAST = 1e-300  # squares of noise
_CLIPPED = 4.0  # residuals beyond this many robust standard deviations are clipped


def sets_of_inputs(rows: Array, spectra: Spectra, level: float) -> Iterator[tuple[Inputs, float, float]]:
    """Yield names, share of squares and p-value of the inputs on which residuals (n, q) depend, set by set."""
    whole = clipped(_condensed(centred(rows)))
    total = float(np.sum(whole**2))
    for _ in range(_MOST_SETS):
        rest = spectra.free(whole)
        odds = log_odds_of_sets(rest, spectra)
        p_value = _p_value(odds)
        if p_value > level:
            return
        inputs = tuple(name for name in spectra.columns if probability_of(name, odds) >= INCLUDED)
        best = max(
            (larger_set for larger_set in odds if set(inputs) <= set(larger_set)),
            key=lambda larger_set: odds[larger_set],
        )
        functions, squares = explained(rest, spectra, best)
        if inputs and squares > 0.0:  # no more than chance is no prediction, whatever its evidence
            yield inputs, min(1.0, squares / total), p_value
        spectra = spectra.beyond(functions)
        if spectra.held is None or spectra.held.shape[1] > _MOST_HELD * len(rest):
            return


def p_value_of_sets(rows: Array, spectra: Spectra) -> float:
    """Return the p-value of a dependence of residuals (n, q) on any set of inputs."""
    return _p_value(log_odds_of_sets(clipped(_condensed(centred(rows))), spectra))


def _p_value(odds: Mapping[Inputs, float]) -> float:
    """Return the p-value of the log odds of all sets over noise: the mean of likelihood ratios exceeds 1 / p by chance
    with a probability of at most p (Markov's inequality)."""
    return float(min(1.0, np.exp(-np.logaddexp.reduce(list(odds.values()))))) if odds else 1.0


def log_odds_of_sets(residual_rows: Array, spectra: Spectra) -> dict[Inputs, float]:
    """Return the log odds of every set of inputs over noise alone, from residuals (n, q)."""
    return odds_of_sets(
        lambda set_of_inputs: float(np.sum(_log_evidence(residual_rows, spectra, set_of_inputs))),
        tuple(spectra.columns),
    )


def odds_of_sets(evidence: Callable[[Inputs], float], names: Inputs, most: int = _MOST_INPUTS) -> dict[Inputs, float]:
    """Return the log odds of every set of up to ``most`` inputs from its log evidence; all sizes of sets have equal
    prior probability, and all sets of a size."""
    log_odds: dict[Inputs, float] = {}
    for size in range(1, most + 1):
        possible = list(combinations(names, size))
        if size > len(names) or not possible:
            break
        prior = -np.log(most * len(possible))
        if size == 3:
            pairs = sorted(
                (names_tried for names_tried in log_odds if len(names_tried) == 2),
                key=lambda names_tried: -log_odds[names_tried],
            )[:_PROBABLE_PAIRS]
            possible = [names_tried for names_tried in possible if any(set(pair) <= set(names_tried) for pair in pairs)]
        for names_tried in possible:
            log_odds[names_tried] = evidence(names_tried) + prior
    return log_odds


def _log_evidence(rest: Array, spectra: Spectra, inputs: Inputs) -> Array:
    """Return the log evidence (q,) of a dependence on a set of inputs, column by column of residuals (n, q)."""
    # Few columns depend on anything: about the root of their number.
    responds = 1.0 / (1.0 + np.sqrt(rest.shape[1]))
    total = np.sum(rest**2, 0)
    by_spectrum = [_log_evidence_of(rest, total, spectrum, spectra.freedom) for spectrum in spectra.of(inputs)]
    if not by_spectrum:
        return np.zeros(rest.shape[1])
    mean = np.logaddexp.reduce(by_spectrum, axis=0) - np.log(len(by_spectrum))
    return np.asarray(np.logaddexp(np.log1p(-responds), np.log(responds) + mean))


def log_evidence_of_spectrum(rest: Array, spectrum: Spectrum, freedom: int) -> Array:
    """Return the log evidence (q,) of a random function over noise, column by column of residuals (n, q)."""
    return _log_evidence_of(rest, np.sum(rest**2, 0), spectrum, freedom)


def _log_evidence_of(rest: Array, total: Array, spectrum: Spectrum, freedom: int) -> Array:
    """Return `log_evidence_of_spectrum` of residuals (n, q) with sums of squares (q,)."""
    return spectrum.of_sizes.log_evidence(spectrum.along(rest).T, total, freedom)


def probability_of(name: str, odds: Mapping[Inputs, float]) -> float:
    """Return the probability that an input belongs to the set on which the residuals depend."""
    every = np.logaddexp.reduce(list(odds.values()))
    with_it = [log_odds for inputs, log_odds in odds.items() if name in inputs]
    return float(np.exp(np.logaddexp.reduce(with_it) - every))


def explained(rest: Array, spectra: Spectra, inputs: Inputs) -> tuple[Array, float]:
    """Return the functions (n, m) of a set of inputs that residuals (n, q) need, and the squares that they predict
    beyond chance."""
    evidence = [log_evidence_of_spectrum(rest, spectrum, spectra.freedom) for spectrum in spectra.of(inputs)]
    best = spectra.of(inputs)[int(np.argmax(np.sum(np.maximum(evidence, 0.0), 1)))]
    along = best.along(rest)
    strongest, size = np.argsort(-best.strengths), 1.0
    for _ in range(2):
        # A direction counts if noise leaves the effect visible there, first of one unit, then of the size found.
        count = int(np.clip(np.sum(size * best.strengths > 1.0), 1, max(spectra.freedom // 3, 1)))
        squares = float(np.sum(along[strongest[:count]] ** 2))
        noise = (float(np.sum(rest**2)) - squares) / max(spectra.freedom - count, 1)
        size = max(1.0, float(np.sqrt(squares / spectra.freedom / max(noise, _LEAST))))
    return spectra.vectors(best, strongest[:count]), squares - count * noise


def clipped(rows: Array) -> Array:
    """Return centred rows (n, q) with outliers clipped: one of them would pass for a narrow peak of a function."""
    robust = 1.4826 * np.median(np.abs(rows - np.median(rows, 0)), 0)
    limit = _CLIPPED * np.maximum(robust, 0.5 * rows.std(0))
    return centred(np.clip(rows, -limit, limit))


def _condensed(rows: Array) -> Array:
    """Return rows (n, q) reduced to as many columns as their rank."""
    left, size, _ = np.linalg.svd(rows, full_matrices=False)
    is_large = size > 1e-6 * size.max(initial=0.0)
    return np.asarray(left[:, is_large] * size[is_large])
