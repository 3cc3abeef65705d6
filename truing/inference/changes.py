"""Two estimates of the same numbers, from data of their own and knowledge that they share: what has changed between?

Each estimate is drawn to the knowledge that both rest on (tolerances), so their errors are correlated: with P the
covariance of that knowledge and B, N those of the estimates, cov(before, now) = B P^-1 N where nothing has changed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truing.inference.arrays import Array

# Combinations of which the later data take away less than this share of what was not known carry no test.
_TOLD = 0.05
# A number is taken to have changed where chance would make any of them look so in one case of so many.
LEVEL = 1e-3
# Numbers whose change explains the difference within this factor of likelihood cannot be told from one another.
_RIVAL = 20.0
# What changes in more places than this is another machine.
MOST = 12


@dataclass(frozen=True)
class NumberComparison:
    """Numbers (n,) before and now, with the covariance (n, n) of their difference where nothing has changed.

    ``answers`` (n, n) is how the difference follows true changes: less than one to one where data are few. ``told``
    (r, n) are the combinations of which the later data tell more than both knew.
    """

    difference: Array
    covariance: Array
    answers: Array
    observable: Array

    @property
    def sigma(self) -> Array:
        """Return one sigma (n,) of the difference."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @cached_property
    def _whitened(self) -> tuple[Array, Array]:
        """Return difference (r,) and answers (r, n) along the directions that carry a test, in standard deviations."""
        white = np.linalg.solve(
            np.linalg.cholesky(self.observable @ self.covariance @ self.observable.T), self.observable
        )
        return white @ self.difference, white @ self.answers

    @property
    def chi_square(self) -> tuple[float, int]:
        """Return the whole difference as a chi-square, and its degrees of freedom."""
        away, _ = self._whitened
        return float(away @ away), len(away)

    def changed(self, level: float = LEVEL) -> tuple[int, ...] | None:
        """Return the fewest numbers (their places) whose changes explain the difference; None where they are too many.

        The one that explains most comes first, then that which explains most of the rest, until chance explains it.
        ``level``: how often chance alone makes any one of them look so, and how often all together.
        """
        found: list[int] = []
        while (worst := self._worst(found, level)) is not None:
            if len(found) == MOST:
                return None
            found.append(worst)
        return tuple(found)

    def sizes(self, changed: tuple[int, ...]) -> tuple[Array, Array]:
        """Return by how much the changed numbers (c,) changed, were they the only ones, and one sigma of that."""
        away, answers = self._whitened
        own = answers[:, changed]
        covariance = np.linalg.inv(own.T @ own)
        return covariance @ (own.T @ away), np.sqrt(np.diag(covariance))

    def instead(self, changed: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
        """Return, for each of the changed numbers, those whose change in its place explains the difference as well."""
        return tuple(self._rivals([i for i in changed if i != place], place) for place in changed)

    def _rivals(self, others: list[int], place: int) -> tuple[int, ...]:
        score, _ = self._scores(others)
        alike = score**2 > score[place] ** 2 - 2.0 * np.log(_RIVAL)
        alike[place] = False
        return tuple(int(i) for i in np.flatnonzero(alike & (score > 0.0)))

    def _scores(self, free: list[int]) -> tuple[Array, float]:
        """Return how much (n,) each number's change explains of what changes of others leave, in standard deviations;
        zero where nothing of it is told; and the sum of squares that is left."""
        away, answers = self._whitened
        basis = np.linalg.qr(answers[:, free])[0]
        rest, columns = (part - basis @ (basis.T @ part) for part in (away, answers))
        size = np.sqrt(np.sum(columns**2, 0))
        seen = size > 1e-3 * np.sqrt(np.sum(answers**2, 0)).max(initial=0.0)
        score = np.where(seen, np.abs(columns.T @ rest) / np.where(seen, size, 1.0), 0.0)
        score[free] = 0.0
        return score, float(rest @ rest)

    def _worst(self, free: list[int], level: float) -> int | None:
        """Return the number whose change explains most of what changes of others leave; None where chance does."""
        from scipy.special import chdtrc, ndtr

        score, square = self._scores(free)
        single = 2.0 * ndtr(-score.max(initial=0.0)) * max(int((score > 0.0).sum()), 1)
        whole = chdtrc(max(self.chi_square[1] - len(free), 1), square)
        return int(score.argmax()) if min(single, whole) < level and score.any() else None


def compare(
    before: Array,
    covariance: Array,
    now: Array,
    covariance_now: Array,
    shared: Array,
    apart: Array | float = 0.0,
) -> NumberComparison:
    """Return the comparison of estimates (n,), covariance (n, n) each.

    shared (n, n): the information that both rest on; apart (n, n): by what else they differ (they are counted from
    different frames), as a covariance.
    """
    root = np.linalg.cholesky(shared)
    left, directions = np.linalg.eigh(root.T @ covariance_now @ root)
    observable = directions[:, 1.0 - left > _TOLD].T @ root.T
    covariance, covariance_now = _within(covariance, root), _within(covariance_now, root)
    crossed = covariance @ shared @ covariance_now
    spread = covariance + covariance_now - crossed - crossed.T + apart
    return NumberComparison(
        now - before, (spread + spread.T) / 2, np.eye(len(now)) - covariance_now @ shared, observable
    )


def _within(covariance: Array, root: Array) -> Array:
    """Return a covariance (n, n) that is narrower everywhere than what was known before, of information root root'.

    One that was enlarged for the noise is wider than that where the data tell next to nothing, and differences have a
    negative variance there; least information takes its place.
    """
    left, directions = np.linalg.eigh(root.T @ covariance @ root)
    back = np.linalg.solve(root.T, directions)
    return np.asarray((back * np.minimum(left, 1.0 - _TOLD)) @ back.T)
