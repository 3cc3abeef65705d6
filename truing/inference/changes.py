"""Comparison of two estimates of the same numbers, from separate data and a shared prior: which numbers have changed?

Each estimate is drawn towards the prior that both share (tolerances), so their errors are correlated: with P the
covariance of the prior and B, N those of the estimates, cov(before, now) = B P^-1 N where nothing has changed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truing.inference.arrays import Array

# Combinations whose prior variance the later data reduce by less than this share are not tested.
_LEAST_GAIN = 0.05
# Familywise p-value at which a number counts as changed.
LEVEL = 1e-3
# Numbers whose change explains the difference within this factor of likelihood are indistinguishable.
_RIVAL = 20.0
# With more changed numbers than this, the machine counts as another one.
MOST = 12


@dataclass(frozen=True)
class NumberComparison:
    """Difference of numbers (n,), now minus before, with its covariance (n, n) if nothing has changed.

    ``answers`` (n, n) is the response of the difference to true changes: less than one to one where data are few.
    ``observable`` (r, n) are the combinations that the later data determine beyond the prior.
    """

    difference: Array
    covariance: Array
    answers: Array
    observable: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation (n,) of the difference."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @cached_property
    def _whitened(self) -> tuple[Array, Array]:
        """Difference (r,) and answers (r, n) along the observable combinations, in standard deviations."""
        white = np.linalg.solve(
            np.linalg.cholesky(self.observable @ self.covariance @ self.observable.T), self.observable
        )
        return white @ self.difference, white @ self.answers

    @property
    def chi_square(self) -> tuple[float, int]:
        """Chi-square of the whole difference, and its degrees of freedom."""
        away, _ = self._whitened
        return float(away @ away), len(away)

    def changed(self, level: float = LEVEL) -> tuple[int, ...] | None:
        """Return the fewest numbers (indices) whose changes explain the difference; None where they are more than
        `MOST`.

        The number that explains most comes first, then the one that explains most of the rest, until the rest is
        consistent with noise. ``level``: p-value of the largest single score, corrected for their number, and of the
        whole rest.
        """
        changed_numbers: list[int] = []
        while (worst := self._worst(changed_numbers, level)) is not None:
            if len(changed_numbers) == MOST:
                return None
            changed_numbers.append(worst)
        return tuple(changed_numbers)

    def sizes(self, changed: tuple[int, ...]) -> tuple[Array, Array]:
        """Return the sizes (c,) of the changes, if no other number changed, and their standard deviations."""
        away, answers = self._whitened
        columns = answers[:, changed]
        covariance = np.linalg.inv(columns.T @ columns)
        return covariance @ (columns.T @ away), np.sqrt(np.diag(covariance))

    def alternatives_to(self, changed: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
        """Return for each changed number the numbers whose change would explain the difference equally well."""
        return tuple(self._rivals([i for i in changed if i != place], place) for place in changed)

    def _rivals(self, others: list[int], place: int) -> tuple[int, ...]:
        score, _ = self._scores(others)
        alike = score**2 > score[place] ** 2 - 2.0 * np.log(_RIVAL)
        alike[place] = False
        return tuple(int(i) for i in np.flatnonzero(alike & (score > 0.0)))

    def _scores(self, free: list[int]) -> tuple[Array, float]:
        """Return the score (n,) of each number's change on the remainder of the other changes, and the sum of squares
        left. Scores are in standard deviations, zero where the data do not determine the change.
        """
        away, answers = self._whitened
        basis = np.linalg.qr(answers[:, free])[0]
        remainder, columns = (part - basis @ (basis.T @ part) for part in (away, answers))
        size = np.sqrt(np.sum(columns**2, 0))
        is_observed = size > 1e-3 * np.sqrt(np.sum(answers**2, 0)).max(initial=0.0)
        score = np.where(is_observed, np.abs(columns.T @ remainder) / np.where(is_observed, size, 1.0), 0.0)
        score[free] = 0.0
        return score, float(remainder @ remainder)

    def _worst(self, free: list[int], level: float) -> int | None:
        """Return the number whose change explains most of the rest; None where the rest is consistent with noise."""
        from scipy.special import chdtrc, ndtr

        score, square = self._scores(free)
        alone = 2.0 * ndtr(-score.max(initial=0.0)) * max(int((score > 0.0).sum()), 1)
        together = chdtrc(max(self.chi_square[1] - len(free), 1), square)
        return int(score.argmax()) if min(alone, together) < level and score.any() else None


def compare(
    before: Array,
    covariance: Array,
    now: Array,
    covariance_now: Array,
    shared: Array,
    apart: Array | float = 0.0,
) -> NumberComparison:
    """Return the comparison of two estimates (n,) with covariances (n, n).

    ``shared`` (n, n): information of the prior of both; ``apart`` (n, n): covariance of further differences between
    them, such as a different frame.
    """
    root = np.linalg.cholesky(shared)
    left, directions = np.linalg.eigh(root.T @ covariance_now @ root)
    observable = directions[:, 1.0 - left > _LEAST_GAIN].T @ root.T
    covariance, covariance_now = _limited_to_prior(covariance, root), _limited_to_prior(covariance_now, root)
    crossed = covariance @ shared @ covariance_now
    spread = covariance + covariance_now - crossed - crossed.T + apart
    return NumberComparison(
        now - before, (spread + spread.T) / 2, np.eye(len(now)) - covariance_now @ shared, observable
    )


def _limited_to_prior(covariance: Array, root: Array) -> Array:
    """Return a covariance (n, n) limited to be smaller than the prior's, whose information is root root'. A covariance
    that was scaled up for the noise can exceed the prior where the data hold almost no information; the difference
    would then have a negative variance."""
    left, directions = np.linalg.eigh(root.T @ covariance @ root)
    back = np.linalg.solve(root.T, directions)
    return np.asarray((back * np.minimum(left, 1.0 - _LEAST_GAIN)) @ back.T)
