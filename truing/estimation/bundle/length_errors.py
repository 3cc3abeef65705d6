"""Length measuring errors of a photogrammetric system against calibrated lengths, after VDI/VDE 2634 part 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index

REFERENCE_TEMPERATURE_C = 20.0
LINES, LENGTHS_PER_LINE = 7, 5  # the guideline's minimum
CONFORMS, UNDECIDED, FAILS = "conforms", "undecided", "does not conform"


@dataclass(frozen=True)
class PermissibleError:
    """Maximum permissible length measuring error E = A + K L, not more than B: in m, 1, m."""

    a_m: float
    k: float = 0.0
    b_m: float = np.inf

    def at(self, length_m: Array) -> Array:
        """Return the largest error (L,) in m permitted at lengths (L,) in m."""
        return np.minimum(self.a_m + self.k * length_m, self.b_m)


@dataclass(frozen=True)
class CalibratedLengths:
    """Lengths of a test body (L,) in m at 20 degrees C, with sigma (L,), and its temperature at the test.

    line (L,): number of the measuring line of each length; None if unknown.
    """

    length_m: Array
    sigma_m: Array
    expansion_per_k: Array | float = 0.0
    temperature_c: Array | float = REFERENCE_TEMPERATURE_C
    line: Index | None = None

    @property
    def expansion(self) -> Array:
        """Factor of the lengths at the temperature of the test."""
        return 1 + np.asarray(self.expansion_per_k) * (np.asarray(self.temperature_c) - REFERENCE_TEMPERATURE_C)


@dataclass(frozen=True)
class LengthErrors:
    """Length measuring errors.

    Per length: error_m (L,) measured minus calibrated at the reference temperature, sigma_m (L,); permitted_m (L,) (NaN
    if not stated), verdict (L,) after ISO 14253-1 with twice the sigma. For all: chi2 of the errors against their full
    covariance with p-value, the common scale error with sigma, and requirements of the guideline that the test misses.
    """

    error_m: Array
    sigma_m: Array
    permitted_m: Array
    verdict: tuple[str, ...]
    chi2: float
    p_value: float
    scale: float
    sigma_scale: float
    lacks: tuple[str, ...]


def length_errors(
    measured_m: Array,
    cov_m2: Array,
    calibrated: CalibratedLengths,
    *,
    volume_m: Array | None = None,
    permissible: PermissibleError | None = None,
) -> LengthErrors:
    """Return the length measuring errors of distances between points.

    measured_m (L,) with cov_m2 (L, L): the expansion of the test body at its temperature is removed from them. volume_m
    (3,): measured volume.
    """
    from scipy.special import chdtrc

    length_m = calibrated.length_m
    error = measured_m / calibrated.expansion - length_m
    cov = cov_m2 + np.diag(np.square(calibrated.sigma_m))
    sigma = np.sqrt(np.diag(cov))
    permitted = np.full(len(error), np.nan) if permissible is None else permissible.at(length_m)
    weighted = np.linalg.solve(cov, np.stack([error, length_m], axis=1))
    information = float(length_m @ weighted[:, 1])
    chi2 = float(error @ weighted[:, 0])
    has_lengths = len(error) > 0
    return LengthErrors(
        error_m=error,
        sigma_m=sigma,
        permitted_m=permitted,
        verdict=_verdicts(error, sigma, permitted),
        chi2=chi2,
        p_value=float(chdtrc(len(error), chi2)) if has_lengths else float("nan"),
        scale=float(length_m @ weighted[:, 0]) / information if has_lengths else float("nan"),
        sigma_scale=information**-0.5 if has_lengths else float("nan"),
        lacks=_unmet_requirements(length_m, calibrated.line, volume_m),
    )


def _verdicts(error: Array, sigma: Array, permitted: Array) -> tuple[str, ...]:
    error_size, expanded_uncertainty = np.abs(error), 2 * sigma
    has_limit = np.isfinite(permitted) | np.isposinf(permitted)
    verdict = np.where(
        error_size + expanded_uncertainty <= permitted,
        CONFORMS,
        np.where(error_size - expanded_uncertainty > permitted, FAILS, UNDECIDED),
    )
    return tuple(np.where(has_limit, verdict, "").tolist())


def _unmet_requirements(calibrated_m: Array, line: Index | None, volume_m: Array | None) -> tuple[str, ...]:
    """Return the requirements of the guideline that these lengths do not meet: lines, lengths per line, their
    extent."""
    unmet: list[str] = []
    lengths_per_line: NDArray = np.bincount(line) if line is not None and len(line) else np.ones(len(calibrated_m), int)
    lengths_per_line = lengths_per_line[lengths_per_line > 0]
    if len(lengths_per_line) < LINES:
        unmet.append(f"{len(lengths_per_line)} measuring lines of {LINES}")
    short_lines = int((lengths_per_line < LENGTHS_PER_LINE).sum())
    if short_lines:
        unmet.append(f"{short_lines} measuring lines with fewer than {LENGTHS_PER_LINE} lengths")
    if volume_m is not None and len(calibrated_m):
        diagonal = float(np.linalg.norm(volume_m))
        if calibrated_m.max() < 2 / 3 * diagonal:
            unmet.append(
                f"the longest is {calibrated_m.max():.3g} m, two thirds of the diagonal {2 / 3 * diagonal:.3g} m"
            )
    return tuple(unmet)
