"""Required rates of a diagnosis over many campaigns: each is a share of the assessed campaigns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tests.blind.generator.quaternions import Array
from tests.blind.judging import WITHIN_95, Assessed, fewest_of, most_of

CLEAR = 6.0  # from this signal-to-noise on an effect must be found; each of two from the second figure on
CLEAR_MATRIX = 8.7
CLEAR_CURVE = 11.0  # of 120 knots, by the theory of a test of so many parameters
CLEAR_OF_TWO = 8.0


@dataclass(frozen=True)
class Count:
    """Number of counted campaigns with the right result, and the names of the others."""

    good: int
    trials: int
    bad: tuple[str, ...]

    @property
    def share(self) -> float:
        return self.good / self.trials if self.trials else float("nan")

    def falls_short(self, wanted: float) -> bool:
        """Return True if so few right results have a probability below 1/1000 at the wanted rate."""
        return self.good < fewest_of(self.trials, wanted) if self.trials else False

    def exceeds(self, allowed: float) -> bool:
        """Return True if so many results have a probability below 1/1000 at the allowed rate."""
        return self.good > most_of(self.trials, allowed) if self.trials else False


def interval(good: int, trials: int) -> tuple[float, float]:
    """Return the exact 95 % bounds of a probability (Clopper and Pearson 1934)."""
    from scipy.stats import beta

    low = beta.ppf(0.025, good, trials - good + 1) if good else 0.0
    high = beta.ppf(0.975, good + 1, trials - good) if good < trials else 1.0
    return float(low), float(high)


def _count(
    campaigns: Iterable[Assessed],
    is_good: Callable[[Assessed], bool],
    tell: Callable[[Assessed], str],
) -> Count:
    judged = [(is_good(campaign), campaign) for campaign in campaigns]
    bad = tuple(tell(one) for good, one in judged if not good)
    return Count(sum(good for good, _ in judged), len(judged), bad)


def is_clear(campaign: Assessed) -> bool:
    """Return True if every hidden effect is strong enough to be found in nearly all campaigns."""
    two = len(campaign.hidden) > 1
    return all(effect.strength >= 0.99 * clear_from(effect.cause, two=two) for effect in campaign.hidden)


def clear_from(cause: str, *, two: bool = False) -> float:
    """The signal-to-noise from which a cause must be found."""
    many = {"platform-deformation-matrix": CLEAR_MATRIX, "joint-error-curve": CLEAR_CURVE}
    return many.get(cause, CLEAR_OF_TWO if two else CLEAR)


def summary(campaign: Assessed) -> str:
    """One line with the hidden and the found effects of a campaign."""
    hidden = (
        ", ".join(f"{e.kind} {' '.join(sorted(e.subject))} at {e.strength:.1f}" for e in campaign.hidden) or "nothing"
    )
    found = ", ".join(
        f"{row.verdict} {row.cause} {' '.join(sorted(row.subject | row.follows))}"
        for row in (*campaign.reported, *campaign.suspected)
    )
    return f"{campaign.name} ({campaign.record['truth'].get('layout')}): {hidden} -> {found or 'nothing'}"


def alarms(campaigns: Sequence[Assessed]) -> Count:
    """Campaigns with nothing hidden in which something is found, or an effect whose name is open."""
    return _count([campaign for campaign in campaigns if not campaign.hidden], lambda one: one.detected, summary)


def invented(campaigns: Sequence[Assessed]) -> Count:
    """Campaigns in which more is found next to all that was hidden."""
    right = [campaign for campaign in campaigns if campaign.hidden and not campaign.missed and not _strange(campaign)]
    return _count(right, lambda one: bool(one.invented), summary)


def detected(campaigns: Sequence[Assessed]) -> Count:
    """Campaigns with one effect in which anything is found, or an effect whose name is open."""
    return _count(_of_one(campaigns), lambda one: one.detected, summary)


def named(campaigns: Sequence[Assessed]) -> Count:
    """Campaigns with one effect that is named, or reported as indistinguishable from what was found."""
    return _count(_of_one(campaigns), lambda one: not one.missed, summary)


def placed(campaigns: Sequence[Assessed]) -> Count:
    """Campaigns with one effect that is named: those where it concerns the right legs or targets."""
    right = [one for one in _of_one(campaigns) if not one.missed]
    return _count(right, lambda one: not one.misplaced(one.hidden[0]), summary)


def both_named(campaigns: Sequence[Assessed]) -> Count:
    """Campaigns with two effects of which both are named."""
    return _count(
        [campaign for campaign in campaigns if len(campaign.hidden) == 2], lambda one: not one.missed, summary
    )


def driven(campaigns: Sequence[Assessed]) -> Count:
    """Campaigns with an effect of no catalogue that is reported as unexplained, with its inputs."""
    return _count(_strangers(campaigns), lambda one: one.follows_right(one.hidden[0]), summary)


def misnamed(campaigns: Sequence[Assessed]) -> Count:
    """The same where it is given a name of the catalogue."""
    return _count(_strangers(campaigns), lambda one: bool(one.misnamed), summary)


def pulled(campaigns: Sequence[Assessed]) -> Count:
    """Campaigns in which all was named and the geometry's pulls lie in their 95 % band after the extension."""
    sums = [(one, row) for one in _complete(campaigns) for row in one.record["pull_sums"] if row["model"] == "extended"]
    inside = {one.name: row["lower"] <= row["chi_square"] <= row["upper"] for one, row in sums}
    return _count([one for one, _ in sums], lambda one: inside[one.name], summary)


def coverage(campaigns: Sequence[Assessed]) -> Array:
    """Share of the true parameters within the stated 95 % interval, per campaign with one effect found and placed."""
    right = [one for one in _of_one(campaigns) if not one.missed and not one.misplaced(one.hidden[0])]
    pulls = [one.pulls(one.hidden[0]) for one in right]
    return np.array([np.mean(np.abs(z) <= WITHIN_95) for z in pulls if len(z)])


def floors(campaigns: Sequence[Assessed]) -> Array:
    """Held-out error over the noise floor after the extension, per campaign in which all was named."""
    return np.array([one.floor_ratio for one in _complete(campaigns) if one.floor_ratio is not None])


def excesses(campaigns: Sequence[Assessed]) -> Array:
    """Held-out excess over the floor without and with what was found (C, 2), per campaign in which all was named.

    What is in no catalogue has no name: its form claims nothing beyond what was fitted.
    """
    named = [one for one in _complete(campaigns) if not _strange(one)]
    return np.array([one.excess for one in named if one.excess is not None]).reshape(-1, 2)


def _complete(campaigns: Sequence[Assessed]) -> list[Assessed]:
    return [campaign for campaign in campaigns if campaign.hidden and not campaign.missed and campaign.found]


def _of_one(campaigns: Sequence[Assessed]) -> list[Assessed]:
    return [campaign for campaign in campaigns if len(campaign.hidden) == 1 and not _strange(campaign)]


def _strangers(campaigns: Sequence[Assessed]) -> list[Assessed]:
    return [campaign for campaign in campaigns if _strange(campaign)]


def _strange(campaign: Assessed) -> bool:
    return any(effect.cause == "unexplained" for effect in campaign.hidden)
