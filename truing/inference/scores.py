"""Score of a candidate on a fitted model: what it explains, and how probable it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, grouped
from truing.inference.evidence import LIKE_SIZES, SIZES, like_sized_log_evidence, log_evidence, log_possible, sizes_of
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT
from truing.inference.search import CauseCandidate, total_of
from truing.inference.signatures import Signature

# Prior probability that parameters of like parts have like size instead of independent sizes.
_ALIKE = 0.7
_LEAST_LEFT = 1e-12  # share of the squares; rounding may make an almost complete reduction negative


@dataclass(frozen=True)
class Score:
    """Score of one candidate."""

    squares: float  # reduction of the sum of squares
    log_evidence: float  # marginal likelihood over that of the model without it
    log_posterior: float  # log evidence plus log prior
    along: Array  # (r,) scores along its directions
    log_signs: float = 0.0  # part of the log evidence due to signs that are physically impossible

    @property
    def signal_to_noise(self) -> float:
        """Root of the reduction of the sum of squares."""
        return float(np.sqrt(self.squares))


def scores_of(candidates: Sequence[CauseCandidate[CauseT]], fitted: FittedModel[CauseT], along: Array) -> list[Score]:
    """Return the scores of candidates, from the parts (B, C) of the residual along the pathways."""
    parts = [parts_of(candidate.signature, along) for candidate in candidates]
    evidence = log_evidences_of(candidates, fitted, parts)
    scores = []
    for candidate, part, log_odds in zip(candidates, parts, evidence, strict=True):
        prior = float(np.log(max(candidate.prior, 1e-300)))
        signs = signs_of(candidate, fitted, part) if len(part) else 0.0
        odds = log_odds + signs
        scores.append(Score(float(part @ part), odds, odds + prior, part, signs))
    return scores


def parts_of(effect: Signature, along: Array) -> Array:
    """Return the parts (r,) of a residual along a candidate's unit directions, from those along the pathways (B, C)."""
    if not effect.rank:
        return np.zeros(0)
    return np.asarray((along[:, effect.index].ravel() @ effect.design) @ (effect.loadings / effect.strengths))


def signs_of(candidate: CauseCandidate[CauseT], fitted: FittedModel[CauseT], parts: Array) -> float:
    """Return the part of a candidate's log evidence that is due to parameters that cannot be negative."""
    places = candidate.cause.one_sided(fitted.model.part_count)
    if not places:
        return 0.0
    effect = candidate.signature
    covariance = posterior_covariance(effect.loadings, effect.strengths)
    return log_possible(effect.fitted(parts), covariance, places, *squares_left(fitted, parts))


def posterior_covariance(loadings: Array, strengths: Array) -> Array:
    """Return the covariance (P, P) of parameters in plausible scales: that of the data along orthonormal directions
    ``loadings`` (P, r), and a plausible size along all others, which the data do not show."""
    unseen = np.eye(len(loadings)) - loadings @ loadings.T
    return np.asarray((loadings / strengths**2) @ loadings.T + unseen)


def squares_left(fitted: FittedModel[CauseT], parts: Array) -> tuple[float, float]:
    """Return the sum of squares that an effect leaves, and its degrees of freedom, from the parts (r,) of the residual
    along its directions."""
    total, freedom = total_of(fitted)
    return max(total - float(parts @ parts), _LEAST_LEFT * total), freedom


def log_evidence_of(
    candidate: CauseCandidate[CauseT], fitted: FittedModel[CauseT], parts: Array, stretch: float = 1.0
) -> float:
    """Return a candidate's log evidence, as `log_evidences_of`."""
    return log_evidences_of([candidate], fitted, [parts], stretch)[0]


def log_evidences_of(
    candidates: Sequence[CauseCandidate[CauseT]],
    fitted: FittedModel[CauseT],
    parts: Sequence[Array],
    stretch: float = 1.0,
) -> list[float]:
    """Return the log evidence of candidates from the parts (r,) of the residual along each.

    It is averaged over parameters of like size, where a candidate has such, and independent ones. Candidates of the
    same rank, of the same parameters of like size, and of the same possible sizes are computed at once.
    """
    total, freedom = total_of(fitted)
    signatures = [candidate.signature for candidate in candidates]
    known = [candidate.cause.has_known_scale for candidate in candidates]
    evidence = np.zeros(len(candidates))
    ranks = [len(effect.strengths) for effect in signatures]
    for (rank, is_known), places in grouped(zip(ranks, known, strict=True)).items():
        if rank:
            strengths = np.stack([signatures[place].strengths for place in places])
            along = np.stack([parts[place] for place in places])
            possible = sizes_of(SIZES, stretch, is_known=is_known)
            evidence[places] = log_evidence(along, strengths, total, freedom, possible)
    members = [tuple(candidate.cause.like_sized(fitted.model.part_count)) for candidate in candidates]
    counts = [len(effect.loadings) if len(effect.strengths) else 0 for effect in signatures]
    keys = [own if own[0] and own[1] else None for own in zip(members, counts, known, strict=True)]
    for key, places in grouped(keys).items():
        if key is not None:
            scores = np.stack(
                [signatures[place].loadings @ (parts[place] * signatures[place].strengths) for place in places]
            )
            gram = np.stack(
                [(signatures[p].loadings * signatures[p].strengths ** 2) @ signatures[p].loadings.T for p in places]
            )
            possible = sizes_of(LIKE_SIZES, stretch, is_known=key[2])
            alike = like_sized_log_evidence(scores, gram, key[0], total, freedom, possible)
            evidence[places] = np.logaddexp(np.log(_ALIKE) + alike, np.log(1 - _ALIKE) + evidence[places])
    return [float(value) for value in evidence]


def raw_scores(effect: Signature, score: Score) -> Array:
    """Return the scores (P,) of a candidate's parameters, from the scores along its directions."""
    return np.asarray(effect.loadings @ (score.along * effect.strengths))
