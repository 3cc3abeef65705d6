"""Candidates of a search: all that a fitted model can take up, of each kind of cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truing.inference.channel_signatures import RotatedChannels, channel_signatures, rotated_channels
from truing.inference.evidence import log_evidence
from truing.inference.fitted_model import FittedModel
from truing.inference.model import OBSERVED, CauseT
from truing.inference.search import CauseCandidate, ChannelFamily, Search, total_of
from truing.inference.signatures import Pathways, signature, signatures_of

# Number of single channels with the most evidence that become candidates of their own.
_BEST_MEMBERS = 4
# Prior probability, within its kind, that an accepted nonparametric effect has higher-order terms.
HIGHER_ORDER_SHARE = 0.5


def search_of(
    fitted: FittedModel[CauseT], kinds: Sequence[CauseT], draws: int, rng: np.random.Generator
) -> Search[CauseT]:
    """Return the search over all candidates of the kinds of cause, on the residuals of a fitted model."""
    pathways = fitted.pathways
    candidates, families = _proposed(fitted, pathways, kinds), _families(fitted, pathways, kinds)
    for family in families:
        candidates += _best_members(fitted, pathways, family)
    shares = {kind.id: kind.share for kind in kinds}
    return Search(pathways, fitted.noise, candidates, families, shares, draws, rng, fitted.model.part_count)


def _proposed(fitted: FittedModel[CauseT], pathways: Pathways, kinds: Sequence[CauseT]) -> list[CauseCandidate[CauseT]]:
    listed: list[tuple[CauseT, str, float]] = []
    scene = fitted.scene
    for kind in kinds:
        higher = admissible(
            fitted,
            [c for accepted in fitted.causes if accepted.id == kind.id for c in scene.higher_order_terms(accepted)],
        )
        for proposed in (admissible(fitted, scene.candidates(kind)), higher):
            weights = np.array([scene.prior(cause) for cause in proposed])
            total_weight = max(weights.sum(), 1e-300) / (HIGHER_ORDER_SHARE if higher else 1.0)
            listed += [(c, kind.id, float(weight)) for c, weight in zip(proposed, weights / total_weight, strict=True)]
    # Candidates of all kinds at once: many kinds move the same.
    effects = signatures_of(pathways, (fitted.partial_designs(cause) for cause, _, _ in listed))
    return [CauseCandidate(c, kind, e, prior) for (c, kind, prior), e in zip(listed, effects, strict=True)]


def admissible(fitted: FittedModel[CauseT], proposed: Sequence[CauseT]) -> list[CauseT]:
    """Return the causes that a fitted model can take up."""
    return [cause for cause in proposed if not any(accepted.excludes(cause) for accepted in fitted.causes)]


def candidate_of(
    fitted: FittedModel[CauseT], pathways: Pathways, cause: CauseT, kind: str, prior: float
) -> CauseCandidate[CauseT]:
    return CauseCandidate(cause, kind, signature(pathways, fitted.design_matrix(cause)), prior)


def _families(fitted: FittedModel[CauseT], pathways: Pathways, kinds: Sequence[CauseT]) -> list[ChannelFamily[CauseT]]:
    families = []
    rotations, scene = fitted.model.rotations(fitted.fit.shared, fitted.fit.local), fitted.scene
    rotated: dict[tuple[tuple[int, ...], bytes], RotatedChannels] = {}  # shared by most families
    for kind in kinds:
        for channel_candidate in scene.channel_candidates(kind):
            key = channel_candidate.channels.shape, channel_candidate.channels.tobytes()
            rotated[key] = rotated.get(key) or rotated_channels(
                pathways, channel_candidate.channels, rotations, channel_candidate.patterns
            )
            signatures = channel_signatures(
                rotated[key], channel_candidate.values * channel_candidate.scale, channel_candidate.usable
            )
            if signatures.is_observed.any():
                families.append(ChannelFamily(channel_candidate, kind.id, signatures))
    return families


def _best_members(
    fitted: FittedModel[CauseT], pathways: Pathways, family: ChannelFamily[CauseT]
) -> list[CauseCandidate[CauseT]]:
    """Return the candidates over single channels with the most evidence, each channel at its best shape."""
    signatures = family.signatures
    scores = signatures.scores(signatures.rotated.along(pathways.residual[None][:, :, pathways.places[OBSERVED]]))[
        ..., 0
    ]
    values, vectors = np.linalg.eigh(signatures.gram)
    strengths = np.sqrt(np.maximum(values, 1e-12))
    parts = np.einsum("stpr,stp->str", vectors, scores) / strengths
    total, freedom = total_of(fitted)
    odds = np.where(signatures.is_observed, log_evidence(parts, strengths, total, freedom), -np.inf)
    members = []
    for channel in np.argsort(-odds.max(0), kind="stable")[:_BEST_MEMBERS]:
        shape = int(np.argmax(odds[:, channel]))
        cause = family.cause.member(int(channel), shape) if np.isfinite(odds[shape, channel]) else None
        if cause is not None and cause.key not in fitted.model.layout:
            best = candidate_of(fitted, pathways, cause, family.kind, family.prior)
            members.append(replace(best, chosen_from=int(signatures.is_observed.sum())))
    return members
