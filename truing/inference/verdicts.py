"""Verdict on each candidate cause: decision, evidence, and effect on predictions."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Generic

import numpy as np

from truing.inference.arrays import Array
from truing.inference.block_gain import BlockGain
from truing.inference.fitted_model import FittedModel
from truing.inference.free_course import CourseRival
from truing.inference.model import OBSERVED, CauseT, ConditionsLike
from truing.inference.observations import Epochs, Observations, whitened_columns
from truing.inference.prediction import NoiseFloor, PredictionError
from truing.inference.rounds import Round
from truing.inference.search import LEAST_P, CauseCandidate
from truing.inference.signatures import Signature
from truing.inference.without_causes import errors_without

FOUND, SUSPECTED, INDISTINGUISHABLE, REJECTED = "found", "suspected", "indistinguishable", "rejected"

NOT_TESTABLE = "not testable"  # no plausible size would have been found


class Reason(StrEnum):
    """Reason why a candidate was not found, or is only suspected."""

    CHANCE = "chance"  # not significant
    HELD_OUT = "held-out"  # held-out epochs are predicted worse with it
    DROPPED = "dropped"  # the other accepted causes explain its effect
    CONTAINED = "contained"  # the final model leaves no direction in which it can be seen
    UNSEEN = "unseen"  # the campaign cannot see it
    RIVAL = "rival"  # indistinguishable from a cause that was found
    ENDED = "ended"  # significant, but the search reached a limit first
    INADEQUATE = "inadequate"  # the final model does not hold as a whole
    ALTERNATIVE = "alternative"  # another cause may explain the same
    ASSUMED = "assumed"  # it takes for known what was not declared
    WEAK = "weak"  # significant, but hardly more probable than no effect
    UNNAMED = "unnamed"  # it may be a part of a nonparametric or unknown effect
    COURSE = "course"  # a random course of the same effect is as probable, or acts next to it
    NOT_RANDOM = "not-random"  # its errors repeat, depend on an input, or are a few large ones, unlike scatter
    UNPAID = "unpaid"  # predictions do not improve with it
    UNCONFIRMED = "unconfirmed"  # blocks of epochs left out gain far less from it than from an effect of its size
    ELSEWHERE = "elsewhere"  # blocks of epochs left out are less probable with it


@dataclass(frozen=True)
class Verdict(Generic[CauseT]):
    """Verdict on one candidate cause: decision, evidence, and prediction errors without and with it."""

    cause: CauseT
    verdict: str  # found, suspected, indistinguishable, rejected, not testable
    p_value: float
    probability: float
    log_odds: float  # over the model without it, in the round in which it was found, or else the first round
    signal_to_noise: float
    scale_holds: bool | None
    before: PredictionError[CauseT]  # all found causes of smaller rank accepted
    after: PredictionError[CauseT]
    held_out: tuple[PredictionError[CauseT] | None, PredictionError[CauseT] | None]
    floor: NoiseFloor
    values: Array  # (P,) SI
    covariance: Array  # (P, P)
    candidates: int  # number of candidates tried together
    with_it: FittedModel[CauseT] | None = (
        None  # the model that holds it: after its acceptance, or as a rival in its place
    )
    reason: Reason | None = None
    rival: CauseT | None = None  # the cause from which it is indistinguishable
    course: CourseRival | None = None  # random courses that are as probable as the cause, or act next to it
    share_explained: float | None = None  # its share of the squares that it and nonparametric effects explain together
    # For accepted causes: whether the campaign declares groupings of epochs, and the gain in blocks left out.
    blocks_asked: bool = False
    block_gain: BlockGain | None = None
    subjects: tuple[tuple[str, float], ...] = ()  # other possible subjects of a found cause, with the odds against each
    onsets: tuple[CauseT, CauseT] | None = None  # the cause at its earliest and latest possible onset
    inputs: tuple[tuple[tuple[str, ...], float], ...] = ()  # the same, of inputs of a nonparametric effect
    quantities: tuple[str, ...] = ()  # quantities of its subject that a nonparametric effect may change instead

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key of verdicts: accepted ones in order of acceptance, the others by probability."""
        order = {FOUND: 0, SUSPECTED: 0, INDISTINGUISHABLE: 1, REJECTED: 2, NOT_TESTABLE: 3}[self.verdict]
        return order, (0.0 if order == 0 else -self.probability)


def first_order(
    current: Round[CauseT],
    candidate: CauseCandidate[CauseT],
    verdict: str,
    held_out: Epochs[ConditionsLike] | None,
    reason: Reason | None = None,
) -> Verdict[CauseT]:
    """Return a verdict on a candidate, with its effect on a round's model to first order."""
    fitted, signature = current.fitted, candidate.signature
    values = signature.fitted(current.scores[candidate.key].along)
    sigma = fitted.noise_ratio * signature.loadings / signature.strengths
    scale = np.array([p.scale for p in candidate.cause.parameters(fitted.model.part_count)])
    return Verdict(
        candidate.cause,
        verdict,
        *_evidence(current, candidate),
        None,
        fitted.error,
        after_first_step(fitted, candidate.cause, signature, values),
        _held_out(fitted, candidate, values, held_out),
        fitted.floor,
        values * scale,
        (sigma @ sigma.T) * np.outer(scale, scale),
        current.tried,
        reason=reason,
    )


def _evidence(current: Round[CauseT], candidate: CauseCandidate[CauseT]) -> tuple[float, float, float, float]:
    """Return p-value, probability, log odds and signal-to-noise ratio of a candidate in a round."""
    return (
        current.p_value(candidate),
        current.probabilities[candidate.kind],
        current.posterior(candidate),
        current.scores[candidate.key].signal_to_noise,
    )


def _held_out(
    fitted: FittedModel[CauseT],
    candidate: CauseCandidate[CauseT],
    values: Array,
    held_out: Epochs[ConditionsLike] | None,
) -> tuple[PredictionError[CauseT] | None, PredictionError[CauseT] | None]:
    """Return the prediction errors of held-out epochs without and with a candidate; (None, None) where none are held
    out."""
    error_with = held_out_after_first_step(fitted, candidate.cause, candidate.signature, values, held_out)
    return (None if error_with is None else fitted.held_out), error_with


def accepted(
    current: Round[CauseT],
    candidate: CauseCandidate[CauseT],
    cause: CauseT,
    fits: tuple[FittedModel[CauseT], FittedModel[CauseT]],
    final: FittedModel[CauseT],
) -> Verdict[CauseT]:
    """Return the verdict on a candidate that a round accepted in the form ``cause``.

    Errors are those of the ``fits`` without and with it, values those of the final model.
    """
    without, with_cause = fits
    others = [c for c in current.best.values() if c.kind != candidate.kind]
    return Verdict(
        cause,
        FOUND,
        *_evidence(current, candidate),
        current.scale_holds(candidate, others),
        without.error,
        with_cause.error,
        (without.held_out, with_cause.held_out),
        final.floor,  # of this data there is one: that of ``with_cause`` counts what is not found yet as noise
        *final.values(cause),
        current.tried,
        with_it=with_cause,
    )


def verdict_on_known_cause(
    cause: CauseT, plain: FittedModel[CauseT], final: FittedModel[CauseT], held_out: Epochs[ConditionsLike] | None
) -> Verdict[CauseT]:
    """Return the verdict on a cause that was known before any search and is part of the plain and the final model.

    Errors are those of the plain model without and with it, both with the set-up fitted. Its size, and the p-value of
    that size among those of all subjects of its kind, are those of the final model.
    """
    error_without, held_out_error = errors_without(plain, (cause,), held_out)
    gain = float(np.sum(error_without.squares) - np.sum(plain.error.squares))
    values, covariance = final.values(cause)
    candidates = max(len(final.scene.candidates(cause)), 1) if len(values) else 1
    return Verdict(
        cause,
        FOUND,
        _p_value_of_size(cause, values, covariance, candidates),
        1.0,
        gain / 2.0,
        float(np.sqrt(max(gain, 0.0))),
        True,
        error_without,
        plain.error,
        (held_out_error, plain.held_out),
        plain.floor,
        values,
        covariance,
        candidates,
        with_it=plain,
    )


def _p_value_of_size(cause: CauseT, values: Array, covariance: Array, candidates: int) -> float:
    """Return the p-value of fitted values (P,) by Wald's test, corrected for the candidates; the least without any."""
    if not len(values):
        return LEAST_P
    from scipy.special import chdtrc

    whole = cause.with_known_part(values)
    squares = float(whole @ np.linalg.solve(covariance, whole))
    return float(np.clip(candidates * chdtrc(len(values), squares), LEAST_P, 1.0))


def after_first_step(
    fitted: FittedModel[CauseT], cause: CauseT, signature: Signature, values: Array
) -> PredictionError[CauseT]:
    """Return the error on calibration epochs after a first-order step to a candidate's parameters (P,), in plausible
    scales."""
    step = _shared_step(fitted, signature, values)
    return _shifted_error(fitted.error, fitted.measured, cause, values, step)


def held_out_after_first_step(
    fitted: FittedModel[CauseT],
    cause: CauseT,
    signature: Signature,
    values: Array,
    held_out: Epochs[ConditionsLike] | None,
) -> PredictionError[CauseT] | None:
    """Return the same on held-out epochs, None where there are none."""
    if held_out is None or fitted.held_out is None:
        return None
    return _shifted_error(fitted.held_out, held_out.measured, cause, values, _shared_step(fitted, signature, values))


def _shared_step(fitted: FittedModel[CauseT], signature: Signature, values: Array) -> Array:
    """Return the change of the shared unknowns (G,), in prior sigmas, that a candidate's parameters cause."""
    return -fitted.fit.whitened.from_basis(signature.explained @ values)


def _shifted_error(
    error: PredictionError[CauseT], measured: Observations, cause: CauseT, values: Array, step: Array
) -> PredictionError[CauseT]:
    motion = _motion(error, cause) @ values
    columns = whitened_columns(measured, error.frames, motion[..., None])[..., 0]
    return error.after_step(columns + error.linearised.moved(step))


def _motion(error: PredictionError[CauseT], cause: CauseT) -> Array:
    """Return the derivatives (B, K, d, P) of the observations by a candidate's parameters, per plausible scale."""
    designs, epochs, size = error.design_matrix(cause), len(error.local), error.measured.size
    parts: list[Array] = [
        error.pathways[name] @ design[:, None] for name, design in designs.items() if name != OBSERVED
    ]
    if OBSERVED in designs:
        design_of_channels = designs[OBSERVED]
        parts.append(
            np.broadcast_to(design_of_channels, (epochs, *design_of_channels.shape[1:])).reshape(
                epochs, -1, size, design_of_channels.shape[-1]
            )
        )
    return np.sum(parts, axis=0) if len(parts) > 1 else parts[0]
