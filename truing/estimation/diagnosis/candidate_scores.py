"""What the data say of one candidate: by how much it lowers the sum of squares, and its evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.alike_evidence import alike_log_evidence
from truing.estimation.diagnosis.candidate_search import Candidate
from truing.estimation.diagnosis.evidence import log_evidence, log_possible
from truing.estimation.diagnosis.fitted_model import Stand
from truing.estimation.diagnosis.signatures import Channels, Signature

# The probability that parameters of parts that were made alike are of like size, and not independent of each other.
_ALIKE = 0.7


@dataclass(frozen=True)
class Score:
    """What the data say of one candidate."""

    squares: float  # by which it lowers the sum of squares
    log_evidence: float  # marginal likelihood over that of the model without it
    log_posterior: float  # the same with what was probable beforehand
    along: NDArray  # (r,) scores along its directions
    log_signs: float = 0.0  # what of the evidence is owed to signs that nature does not have

    @property
    def signal_to_noise(self) -> float:
        """Return the root of the reduction of the sum of squares."""
        return float(np.sqrt(self.squares))


def score_of(candidate: Candidate, stand: Stand, channels: Channels, along: NDArray) -> Score:
    own = candidate.signature
    if not own.rank:
        return Score(0.0, 0.0, float(np.log(candidate.prior)), np.zeros(0))
    parts = along[:, own.index].ravel() @ own.unit_design
    signs = signs_of(candidate, stand, parts)
    odds = log_evidence_of(candidate, stand, parts) + signs
    return Score(float(parts @ parts), odds, odds + float(np.log(max(candidate.prior, 1e-300))), parts, signs)


def signs_of(candidate: Candidate, stand: Stand, parts: NDArray) -> float:
    """Return what a candidate's log evidence owes to the signs of parameters that nature makes on one side only."""
    places = candidate.cause.one_sided(stand.model.leg_count)
    if not places:
        return 0.0
    own = candidate.signature
    covariance = (own.loadings / own.strengths**2) @ own.loadings.T
    return log_possible(own.fitted(parts), covariance, places)


def log_evidence_of(candidate: Candidate, stand: Stand, parts: NDArray, stretch: float = 1.0) -> float:
    """Return a candidate's log evidence: of parameters of like size where there are such, or independent ones."""
    own, (total, freedom) = candidate.signature, total_of(stand)
    independent = float(log_evidence(parts, own.strengths, total, freedom, stretch))
    members = candidate.cause.alike(stand.model.leg_count)
    if not members:
        return independent
    scores = own.loadings @ (parts * own.strengths)
    gram = (own.loadings * own.strengths**2) @ own.loadings.T
    alike = alike_log_evidence(scores, gram, members, total, freedom, stretch)
    return float(np.logaddexp(np.log(_ALIKE) + alike, np.log(1 - _ALIKE) + independent))


def raw_scores(own: Signature, score: Score) -> NDArray:
    """Return the scores (P,) of a candidate's parameters, from those along its directions."""
    return np.asarray(own.loadings @ (score.along * own.strengths))


def total_of(stand: Stand) -> tuple[float, float]:
    noise = stand.noise
    return noise.points_total + noise.readings_total, noise.points + noise.readings
