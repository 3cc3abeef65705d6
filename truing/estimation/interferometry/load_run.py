"""One run of a channel under one load that goes up and down: its zero, its drift and its response, told apart.

Columns have the forms of the effects of a campaign (F the load, F_max its largest value), so that what is fitted here
is what an effect's parameters mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Term = Literal["zero", "drift", "response", "asymmetry", "cubic", "hysteresis", "material", "air"]

PLAIN: tuple[Term, ...] = ("zero", "drift", "response")
_OPEN = 1e-8  # share of a column, squared, that the others have to leave of it


def branches(load: ArrayLike) -> NDArray[np.int64]:
    """Return for steps (N,) in the order in which they were taken: 1 where the load grew away from zero (or changed
    its sign), -1 where it came back, and the branch before where it stayed; 0 until it first moves.

    Of several loads at once (N, A), in comparable units, the largest decides; its sign is their direction's.
    """
    load = np.asarray(load, float)
    load = load[:, None] if load.ndim == 1 else load
    before = np.concatenate([np.zeros((1, load.shape[1])), load[:-1]])
    size, size_before = (np.abs(values).max(axis=1, initial=0.0) for values in (load, before))
    grew = np.where(np.sum(load * before, axis=1) < 0.0, 1.0, np.sign(size - size_before))
    last = np.maximum.accumulate(np.where(grew != 0.0, np.arange(len(load)), -1))
    return np.where(last >= 0, grew[np.maximum(last, 0)], 0.0).astype(np.int64)


def run_columns(
    load: ArrayLike,
    time_s: ArrayLike,
    terms: tuple[Term, ...] = PLAIN,
    *,
    material_c: ArrayLike | None = None,
    air_c: ArrayLike | None = None,
) -> Array:
    """Return the columns (N, P) of a run's terms at steps (N,).

    zero; drift per second since the first step; response per unit of load; asymmetry and cubic as ``F sign F / 2`` and
    ``F (F / F_max)^2``; hysteresis: ``4 f (1 - f) sign F`` with ``f = |F| / F_max`` on the way back, its widest
    point one; material and air: temperatures in K since the first step.
    """
    load, time = np.asarray(load, float), np.asarray(time_s, float)
    largest = max(float(np.max(np.abs(load), initial=0.0)), np.finfo(float).tiny)
    part = np.abs(load) / largest
    made = {
        "zero": np.ones_like(load),
        "drift": time - time[0],
        "response": load,
        "asymmetry": 0.5 * np.abs(load),
        "cubic": load * part**2,
        "hysteresis": (branches(load) < 0) * 4.0 * part * (1.0 - part) * np.sign(load),
    }
    for name, given in (("material", material_c), ("air", air_c)):
        if name in terms:
            if given is None:
                raise ValueError(f"{name}: found no temperatures, expected one per step ({len(load)})")
            made[name] = np.asarray(given, float) - np.asarray(given, float)[0]
    return np.column_stack([made[term] for term in terms])


@dataclass(frozen=True)
class RunFit:
    """What a run says of its terms (P,): values, covariance (P, P); NaN and infinite variance where ``open``.

    residuals (N,) NaN where nothing was read; chi_square of them, dof their freedom.
    """

    terms: tuple[Term, ...]
    values: Array
    covariance: Array
    open: tuple[Term, ...]
    residuals: Array
    chi_square: float
    dof: int

    @property
    def noise_ratio(self) -> float:
        """Scatter found over that declared; NaN where nothing is left over."""
        return float(np.sqrt(self.chi_square / self.dof)) if self.dof > 0 else float("nan")

    def value(self, term: Term) -> tuple[float, float]:
        """Value and standard deviation of a term."""
        at = self.terms.index(term)
        return float(self.values[at]), float(np.sqrt(self.covariance[at, at]))

    def p_value(self, term: Term) -> float:
        """Two-sided p-value of a term being nothing, at the declared noise; NaN where it is open."""
        from scipy.special import ndtr

        value, sigma = self.value(term)
        return float(2.0 * ndtr(-abs(value) / sigma)) if np.isfinite(value) else float("nan")


def fit_run(reading: ArrayLike, sigma: ArrayLike, columns: Array, terms: tuple[Term, ...]) -> RunFit:
    """Fit readings (N,) with noise sigma by columns (N, P); terms that the run cannot tell from others are open.

    Time and load are told apart only by a load that comes back: a run that only goes up leaves drift and response open.
    """
    y = np.asarray(reading, float)
    seen = np.isfinite(y)
    weight = np.where(seen, 1.0 / np.broadcast_to(np.asarray(sigma, float), y.shape), 0.0)
    design = columns * weight[:, None]
    size = np.linalg.norm(design, axis=0)
    scaled = design / np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > _OPEN
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    lost = np.sqrt(np.sum(vectors[:, ~kept] ** 2, axis=1))
    determined = (lost < np.sqrt(_OPEN)) & (size > 0.0)
    scale = np.where(size > 0.0, size, 1.0)
    white = weight * np.where(seen, y, 0.0)
    theta = inverse @ (scaled.T @ white)
    left = white - scaled @ theta
    both = determined[:, None] & determined[None]
    covariance = np.where(both, inverse / np.outer(scale, scale), 0.0)
    covariance[~determined, ~determined] = np.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        residuals = np.where(seen, left / weight, np.nan)
    return RunFit(
        terms,
        np.where(determined, theta / scale, np.nan),
        covariance,
        tuple(term for term, known in zip(terms, determined, strict=True) if not known),
        residuals,
        float(left @ left),
        int(seen.sum() - kept.sum()),
    )


@dataclass(frozen=True)
class BranchGap:
    """How much more a channel reads on the way back than on the way out, at loads (M,) met on both ways."""

    load: Array
    gap: Array
    sigma: Array


def branch_gap(load: ArrayLike, reading: ArrayLike, sigma: float) -> BranchGap:
    """Return the gap between the branches, away from zero being positive; equal loads of a branch are averaged.

    A drift that was not taken out first is part of it.
    """
    load, reading = np.asarray(load, float), np.asarray(reading, float)
    seen = np.isfinite(reading)
    levels, at = np.unique(load, return_inverse=True)
    way = branches(load)
    means, counts = [], []
    for side in (-1, 1):
        count = np.bincount(at, seen & (way == side), minlength=len(levels))
        total = np.bincount(at, np.where(seen & (way == side), reading, 0.0), minlength=len(levels))
        means.append(total / np.maximum(count, 1.0))
        counts.append(count)
    met = (counts[0] > 0.0) & (counts[1] > 0.0) & (levels != 0.0)
    spread = sigma * np.sqrt(1.0 / np.maximum(counts[0], 1.0) + 1.0 / np.maximum(counts[1], 1.0))
    return BranchGap(levels[met], (np.sign(levels) * (means[0] - means[1]))[met], spread[met])


def gap_of_readings(load: Array, reading: Array, sigma: Array) -> BranchGap:
    """Return the gap of readings (B,), NaN where there is none, with sigma (B,), in one run under loads (B,)."""
    seen = np.isfinite(reading)
    return branch_gap(load, reading, float(np.sqrt(np.mean(sigma[seen] ** 2))) if seen.any() else 1.0)


def widest_gap(met: Sequence[BranchGap]) -> tuple[float, float]:
    """Return the widest mean gap over runs that met the same loads, and the probability of such gaps by chance."""
    from scipy.special import chdtrc

    load, gap, sigma = (np.concatenate([getattr(one, name) for one in met]) for name in ("load", "gap", "sigma"))
    _, at = np.unique(load, return_inverse=True)
    mean = np.bincount(at, gap / sigma**2) / np.bincount(at, sigma**-2.0)
    return float(mean[np.argmax(np.abs(mean))]), float(chdtrc(len(gap), np.sum((gap / sigma) ** 2)))
