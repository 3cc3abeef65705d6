"""Labels for unlabelled points from the survey of one or several bodies.

A labelling is accepted if fewer than 0.001 fits with as many points are expected by chance. It must also beat every
contradicting labelling by odds of a million to one. Otherwise it is refused, and its rivals are named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import exp, log

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.labels.congruence import (
    Constellation,
    Hypothesis,
    contradict,
    find_hypotheses,
    log_expected_accidents,
)

ACCIDENTS_LIMIT = 1e-3
MARGIN_LOG_ODDS = log(1e6)
_SHOWN = 4


class LabellingStatus(StrEnum):
    """Status of a labelling, with the remedy."""

    OK = "ok"
    AMBIGUOUS = "ambiguous"
    TOO_FEW = "too-few-points"
    NO_MATCH = "no-match"

    @property
    def remedy(self) -> str:
        """Advice for the reader of the status, in one sentence."""
        return _REMEDIES[self]


_REMEDIES = {
    LabellingStatus.OK: "Nothing to do.",
    LabellingStatus.AMBIGUOUS: "The targets look the same in several attitudes: name them in the points table, or "
    "add a target that breaks the symmetry.",
    LabellingStatus.TOO_FEW: "Labelling by geometry needs three surveyed targets of the body and three points.",
    LabellingStatus.NO_MATCH: "No part of the cloud has the survey's shape: check units, mirrored axes, the declared "
    "noise, and that the survey is of this body.",
}


@dataclass(frozen=True)
class Rival:
    """A labelling that contradicts the best one."""

    assignment: NDArray  # (N,) survey index of each point, -1 without one
    n_consistent: int
    log_odds: float  # of the best labelling against this one
    name: str  # the labels that it exchanges, in the survey's names


@dataclass(frozen=True)
class Labelling:
    """Labels of N points against a survey of M targets; m.

    If the status is AMBIGUOUS, a point keeps its label only if all near rivals agree on it. Labels are certain, the
    motion may not be: of a body with targets on a line the roll is arbitrary, and nearly on a line the half turn.
    """

    assignment: NDArray  # (N,) survey index of each point, -1 for a point that is not on this body
    missing: NDArray  # survey indices without a point
    status: LabellingStatus
    rivals: tuple[Rival, ...]  # of the best labelling, most probable first
    n_consistent: int  # points at the place of a target
    expected_accidental: float  # expected number of labellings with as many consistent points by chance
    log_odds: float  # of the labelling against its best rival; inf without one
    rms: float  # m, of the consistent points; 0 without any
    T_measurement_survey: NDArray | None  # (4, 4), None unless the status is OK

    @property
    def remedy(self) -> str:
        """Advice on the status."""
        return self.status.remedy


def label_points(
    points: ArrayLike,
    survey: ArrayLike,
    sigma: float,
    names: Sequence[str] | None = None,
    *,
    survey_sigma: ArrayLike | None = None,
) -> Labelling:
    """Return the labels of points (N, 3) from a survey (M, 3), in m, moved by any rigid motion.

    sigma: standard deviation of a coordinate of a point; ``survey_sigma`` (scalar or (M,), default sigma): that of a
    target on the rigid body, including deformation. Points may be missing, and further points may exist. Raises
    ValueError for invalid shapes, values and names.
    """
    named = None if names is None else {"": names}
    sigmas = None if survey_sigma is None else {"": survey_sigma}
    return label_bodies(points, {"": survey}, sigma, named, survey_sigma=sigmas)[""]


def label_bodies(
    points: ArrayLike,
    surveys: Mapping[str, ArrayLike],
    sigma: float,
    names: Mapping[str, Sequence[str]] | None = None,
    *,
    survey_sigma: Mapping[str, ArrayLike] | None = None,
) -> dict[str, Labelling]:
    """Return a labelling per body of points (N, 3); each body moves on its own, and no point belongs to two.

    surveys: body to (M, 3) in that body's frame; names: body to the names of its targets, to name rivals. Of all
    choices of one motion per body the most probable is taken. A body with another motion of similar probability is
    ambiguous, for example one of two identical bodies. Without surveys the result is empty. Otherwise as
    `label_points`.
    """
    cloud = _checked(points, sigma, None, "points")
    bodies = {
        body: _checked(survey, sigma, (survey_sigma or {}).get(body), f"survey {body}".strip())
        for body, survey in surveys.items()
    }
    if not bodies:
        return {}
    known = {body: _names_of(body, len(survey), names) for body, survey in bodies.items()}
    offers = {body: _plausible_hypotheses(cloud, survey) for body, survey in bodies.items()}
    best_total, best = _best_choice(list(offers.values()), len(cloud))
    owners = _owners(best, list(bodies), len(cloud))
    labellings = {}
    for at, (body, survey) in enumerate(bodies.items()):
        mine = best[at]
        if mine is None:
            few = len(cloud) < 3 or len(survey) < 3
            labellings[body] = _refused(cloud, survey, LabellingStatus.TOO_FEW if few else LabellingStatus.NO_MATCH)
            continue
        rivals = []
        for rival in (h for h in offers[body] if contradict(cloud, survey, mine, h)):
            forced = [[rival] if i == at else offer for i, offer in enumerate(offers.values())]
            odds = best_total - _best_choice(forced, len(cloud))[0]
            rivals.append(_rival(mine, rival, odds, known[body], owners))
        match = np.where((mine.match >= 0) & (owners[mine.match] == body), mine.match, -1)
        labellings[body] = _labelling(cloud, survey, mine, match, sorted(rivals, key=lambda rival: rival.log_odds))
    return labellings


def _checked(points: ArrayLike, sigma: float, own_sigma: ArrayLike | None, name: str) -> Constellation:
    cloud = np.asarray(points, np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ValueError(f"{name}: found shape {cloud.shape}, expected (N, 3)")
    if not np.all(np.isfinite(cloud)):
        raise ValueError(
            f"{name}: found a non-finite coordinate, expected finite ones: remove points that were not seen"
        )
    deviation = np.broadcast_to(np.asarray(sigma if own_sigma is None else own_sigma, np.float64), len(cloud))
    if not np.all(np.isfinite(deviation) & (deviation > 0)):
        raise ValueError(f"{name}: found a standard deviation that is not positive, expected one in m")
    return Constellation(cloud, deviation**2)


def _names_of(body: str, n: int, names: Mapping[str, Sequence[str]] | None) -> list[str]:
    if names is None or body not in names:
        return [str(i) for i in range(n)]
    if len(names[body]) != n:
        raise ValueError(f"names of {body or 'the targets'}: found {len(names[body])}, expected {n}")
    return [str(name) for name in names[body]]


def _plausible_hypotheses(cloud: Constellation, survey: Constellation) -> list[Hypothesis]:
    if len(cloud) < 3 or len(survey) < 3:
        return []
    offers = [h for h in find_hypotheses(cloud, survey) if h.score > 0]
    # Every triangle fits a mirror image, and sometimes a fourth point: not by chance, but not a label either.
    if offers and 2 * offers[0].n_consistent < min(len(cloud), len(survey)):
        mirrored = find_hypotheses(cloud, Constellation(survey.points * [1, 1, -1], survey.variance), keep=1)
        better = mirrored and mirrored[0].score > offers[0].score + MARGIN_LOG_ODDS
        return [] if better else offers
    return offers


def _best_choice(offers: list[list[Hypothesis]], n_points: int) -> tuple[float, list[Hypothesis | None]]:
    """Return the log-odds of the most probable choice of one hypothesis (or none) per body, and the choice. A point
    counts for the body that explains it best. Depth-first search, pruned where the rest cannot beat the best known
    choice even without conflicts."""
    reach = np.append(np.cumsum([max((h.score for h in offer), default=0.0) for offer in offers][::-1])[::-1], 0.0)
    best: list = [-1.0, [None] * len(offers)]

    def descend(at: int, gain: NDArray, chosen: list[Hypothesis | None]) -> None:
        total = gain.sum()
        if total + reach[at] <= best[0] + 1e-9:
            return
        if at == len(offers):
            best[:] = [float(total), chosen]
            return
        for hypothesis in offers[at]:
            descend(at + 1, np.maximum(gain, hypothesis.gain), [*chosen, hypothesis])
        descend(at + 1, gain, [*chosen, None])

    descend(0, np.zeros(n_points), [])
    return best[0], best[1]


def _owners(chosen: list[Hypothesis | None], bodies: list[str], n_points: int) -> NDArray:
    """Return the body (N,) that explains each point best, None without one."""
    gains = np.array([np.zeros(n_points) if h is None else h.gain for h in chosen])
    owners = np.array(bodies, object)[gains.argmax(0)]
    owners[gains.max(0) <= 0] = None
    return owners


def _labelling(
    cloud: Constellation, survey: Constellation, best: Hypothesis, match: NDArray, rivals: list[Rival]
) -> Labelling:
    n_consistent = int(np.count_nonzero(match >= 0))
    accidents = exp(min(log_expected_accidents(cloud, survey, max(n_consistent, 3)), 700.0))
    if n_consistent < 3 or accidents > ACCIDENTS_LIMIT:
        return _refused(cloud, survey, LabellingStatus.NO_MATCH, n_consistent, accidents)
    near = [rival for rival in rivals if rival.log_odds < MARGIN_LOG_ODDS]
    labels = np.full(len(cloud), -1)
    labels[match[match >= 0]] = np.flatnonzero(match >= 0)
    for rival in near:
        labels = np.where(rival.assignment == labels, labels, -1)
    status = LabellingStatus.AMBIGUOUS if near else LabellingStatus.OK
    odds = rivals[0].log_odds if rivals else np.inf
    return Labelling(
        labels,
        np.setdiff1d(np.arange(len(survey)), labels),
        status,
        tuple(rivals),
        n_consistent,
        accidents,
        odds,
        best.rms,
        None if near else _homogeneous(best),
    )


def _refused(
    cloud: Constellation,
    survey: Constellation,
    status: LabellingStatus,
    n_consistent: int = 0,
    accidents: float = np.inf,
) -> Labelling:
    nobody = np.full(len(cloud), -1)
    return Labelling(nobody, np.arange(len(survey)), status, (), n_consistent, accidents, 0.0, 0.0, None)


def _rival(best: Hypothesis, rival: Hypothesis, odds: float, names: list[str], owners: NDArray) -> Rival:
    best_points, rival_points = best.assignment, rival.assignment
    moved = np.flatnonzero((best_points != rival_points) & (best_points >= 0) & (rival_points >= 0))
    moved = moved[np.argsort(best_points[moved])]
    if len(moved) == 0:
        rival_bodies = sorted({str(body) for body in owners[rival_points >= 0] if body})
        where = f"on the points of {', '.join(rival_bodies)}" if rival_bodies else "on other points"
        return Rival(rival_points, rival.n_consistent, odds, where)
    text = ", ".join(f"{names[best_points[i]]} as {names[rival_points[i]]}" for i in moved[:_SHOWN])
    more = f" and {len(moved) - _SHOWN} more" if len(moved) > _SHOWN else ""
    return Rival(rival_points, rival.n_consistent, odds, text + more)


def _homogeneous(hypothesis: Hypothesis) -> NDArray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = hypothesis.R, hypothesis.t
    return T
