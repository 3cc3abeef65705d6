"""All candidates that the kinds of cause propose on what a fitted model leaves, over single targets too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.candidate_scores import total_of
from truing.estimation.diagnosis.candidate_search import Candidate, Profiles, Search
from truing.estimation.diagnosis.evidence import log_evidence
from truing.estimation.diagnosis.fitted_model import Stand
from truing.estimation.diagnosis.profile_signatures import TurnedPoints, profile_signatures, turned_points
from truing.estimation.diagnosis.signatures import POINTS, Channels, signature

# Single targets with the most evidence that become candidates of their own.
_BEST_MEMBERS = 4
# The probability, within its kind, that what is left of a form that nobody declared is its further terms.
FURTHER_SHARE = 0.5


def search_of(stand: Stand, kinds: Sequence[Any], draws: int, rng: np.random.Generator) -> Search:
    """Return the search over all candidates that the kinds of cause propose, on what a fitted model leaves."""
    channels = stand.channels()
    candidates, profiles = _proposed(stand, channels, kinds), _profiles(stand, channels, kinds)
    along = channels.along(stand.fit.whitened.rest[None])[0]
    for own in profiles:
        candidates += _best_members(stand, channels, own, along)
    shares = {kind.id: kind.share for kind in kinds}
    return Search(channels, stand.noise, candidates, profiles, shares, draws, rng)


def _proposed(stand: Stand, channels: Channels, kinds: Sequence[Any]) -> list[Candidate]:
    found = []
    for kind in kinds:
        further = opened(stand, [c for own in stand.causes if own.id == kind.id for c in own.further(stand.scene)])
        for proposed in (opened(stand, kind.candidates(stand.scene)), further):
            weights = np.array([cause.prior(stand.scene) for cause in proposed])
            whole = max(weights.sum(), 1e-300) / (FURTHER_SHARE if further else 1.0)
            for cause, weight in zip(proposed, weights / whole, strict=True):
                found.append(candidate_of(stand, channels, cause, kind.id, float(weight)))
    return found


def opened(stand: Stand, proposed: Sequence[Any]) -> list[Any]:
    """Return the causes that the model of a stand has a place for."""
    return [cause for cause in proposed if not any(own.excludes(cause) for own in stand.causes)]


def candidate_of(stand: Stand, channels: Channels, cause: Any, kind: str, prior: float) -> Candidate:
    return Candidate(cause, kind, signature(channels, stand.designer(cause)), prior)


def _profiles(stand: Stand, channels: Channels, kinds: Sequence[Any]) -> list[Profiles]:
    found = []
    turns, scene = stand.model.turns(stand.fit.shared, stand.fit.local), stand.scene
    points: dict[tuple[tuple[int, ...], bytes], TurnedPoints] = {}  # mostly the same for all
    for kind in kinds:
        for own in kind.profiles(scene):
            key = own.targets.shape, own.targets.tobytes()
            points[key] = points.get(key) or turned_points(channels, own.targets, turns, own.patterns)
            signatures = profile_signatures(points[key], own.values * own.scale, own.usable)
            if signatures.seen.any():
                found.append(Profiles(own, kind.id, signatures))
    return found


def _best_members(stand: Stand, channels: Channels, own: Profiles, along: NDArray) -> list[Candidate]:
    """Return the candidates over single targets with the most evidence, each target at its best shape."""
    signatures = own.signatures
    scores = signatures.scores(signatures.points.along(along[None][:, :, channels.places[POINTS]]))[..., 0]
    values, vectors = np.linalg.eigh(signatures.gram)
    strengths = np.sqrt(np.maximum(values, 1e-12))
    parts = np.einsum("stpr,stp->str", vectors, scores) / strengths
    total, freedom = total_of(stand)
    odds = np.where(signatures.seen, log_evidence(parts, strengths, total, freedom), -np.inf)
    found = []
    for target in np.argsort(-odds.max(0), kind="stable")[:_BEST_MEMBERS]:
        shape = int(np.argmax(odds[:, target]))
        cause = own.cause.member(int(target), shape) if np.isfinite(odds[shape, target]) else None
        if cause is not None and cause.key not in stand.model.layout:
            found.append(candidate_of(stand, channels, cause, own.kind, own.prior))
    return found
