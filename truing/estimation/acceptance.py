"""Which causes are accepted into a model of points: forward, the most probable first, everything refitted each time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from truing.estimation.detectable import smallest_detectable
from truing.estimation.evidence import NOISE_PRIOR_FREEDOM, Score, Search, probabilities, project
from truing.estimation.point_fit import Frames, MeasuredPoints, PointFit, fit_points, whitened_columns
from truing.estimation.prediction_error import PredictionError, noise_floor, prediction_error
from truing.estimation.screening import gross_errors

# Rivals within this factor of the best in evidence cannot be told from it.
RIVAL_FACTOR = 20.0
# The share of the declared false-alarm rate that the search is set to, so that the rate is kept and not only met.
BUDGET = 0.6
# A cause is rejected where held-out poses are predicted worse by more than this many standard errors.
_WORSE = 2.5
# How often the search may start anew without gross errors.
_SCREENINGS = 3


class CausalModel(Protocol):
    """A model of points that can take up causes; causes are anything with a ``key``, an ``id`` and ``follows``."""

    @property
    def local_size(self) -> int:
        """Return the number of local unknowns H."""

    @property
    def unpredicted(self) -> NDArray:
        """Return which local unknowns (H,) the model does not claim to predict."""

    def with_causes(self, causes: Sequence[Any]) -> Any:
        """Return the model with these causes among its unknowns."""

    def at(self, conditions: Any) -> Any:
        """Return the model at other poses."""

    def predict(self, shared: NDArray, local: NDArray) -> Any:
        """Return points and derivatives, as `point_fit.Model` does."""

    def signature(self, cause: Any, shared: NDArray, local: NDArray) -> NDArray:
        """Return how the points follow a cause's parameters, per plausible scale."""

    def widened(self, shared: NDArray, model: Any) -> NDArray:
        """Return shared unknowns of this model as those of another."""

    def parameter_count(self, cause: Any) -> int:
        """Return the number of a cause's parameters."""

    def is_named(self, cause: Any) -> bool:
        """Return whether a cause has a name of its own."""


@dataclass(frozen=True)
class Poses:
    """Measured points of some poses, the conditions that the model needs there, and frames to start from."""

    measured: MeasuredPoints
    conditions: Any
    frames: Frames

    def without(self, wrong: NDArray) -> Poses:
        """Return the poses without some points (B, K)."""
        return replace(self, measured=replace(self.measured, seen=self.measured.seen & ~wrong))


@dataclass(frozen=True)
class Stand:
    """A model fitted to the calibration poses, with what it leaves there and on held-out poses."""

    causes: tuple[Any, ...]
    model: Any  # a CausalModel
    fit: PointFit
    error: PredictionError
    held_out: PredictionError | None
    floor: float  # m

    @property
    def noise_ratio(self) -> float:
        """Return the estimated noise level over the declared one, which counts as some observations itself."""
        rest = self.fit.whitened.rest
        freedom = self.fit.whitened.freedom
        return float(np.sqrt((NOISE_PRIOR_FREEDOM + rest @ rest) / (NOISE_PRIOR_FREEDOM + freedom)))

    def covariance(self) -> NDArray:
        """Return the covariance (G, G) of the shared unknowns in prior sigmas, at the estimated noise level."""
        return self.fit.whitened.covariance() * self.noise_ratio**2


@dataclass(frozen=True)
class Verdict:
    """One candidate cause: what was decided, on which scores, and the models without and with it."""

    cause: Any
    verdict: str  # found, indistinguishable, rejected
    score: Score
    probability: float
    before: Stand  # without it, all found causes of smaller rank accepted
    after: Stand  # the same with it
    own: Stand  # where its parameters stand: in place of its rival, or where the campaign still sees it
    candidates: int  # how many were tried together
    reason: str = ""  # indistinguishable: from which cause; rejected: "held-out" (predicts worse) or "contained"


@dataclass(frozen=True)
class Round:
    """A fitted model and what it leaves for each cause that is still open."""

    stand: Stand
    scores: Mapping[str, Score]

    @property
    def probabilities(self) -> dict[str, float]:
        """Return the probability of each open cause, among them and none."""
        return probabilities({name: score.log_evidence for name, score in self.scores.items()})

    def verdict(self, cause: Any, verdict: str, after: Stand, reason: str = "") -> Verdict:
        """Return a verdict on one of the causes, its parameters as fitted in ``after``."""
        return Verdict(
            cause,
            verdict,
            self.scores[cause.key],
            self.probabilities[cause.key],
            self.stand,
            after,
            after,
            len(self.scores),
            reason,
        )


@dataclass(frozen=True)
class Settings:
    """How sure a finding must be, and how the null distribution is drawn."""

    false_alarm: float
    draws: int
    seed: int


class Acceptance:
    """The search over a catalogue for one campaign; ``run`` returns every candidate's verdict and the final model."""

    def __init__(
        self,
        model: CausalModel,
        calibration: Poses,
        held_out: Poses | None,
        settings: Settings,
        progress: Callable[[str], None] = lambda what: None,
    ) -> None:
        self._model, self._calibration, self._held_out = model, calibration, held_out
        self._settings, self._progress = settings, progress
        self.gross = 0  # points taken out as gross errors

    @property
    def _level(self) -> float:
        return BUDGET * self._settings.false_alarm

    def run(self, catalogue: Sequence[Any]) -> tuple[list[Verdict], Stand]:
        """Return verdicts, found ones first in order of acceptance, and the model with all found causes.

        Gross errors that show only against the final model are taken out, and the search starts anew without them.
        """
        plain = self._stand(())
        if self._screened(plain):
            plain = self._stand((), plain)
        for _ in range(_SCREENINGS):
            verdicts, final = self._search(plain, catalogue)
            if not self._screened(final):
                break
            plain = self._stand((), plain)
        return verdicts, final

    def _search(self, plain: Stand, catalogue: Sequence[Any]) -> tuple[list[Verdict], Stand]:
        rounds, open_causes = [self._round(plain, catalogue)], list(catalogue)
        verdicts: list[Verdict] = []
        while (chosen := self._choose(rounds[-1], open_causes)) is not None:
            after = self._stand((*rounds[-1].stand.causes, chosen), rounds[-1].stand)
            if _predicts_worse(rounds[-1].stand.held_out, after.held_out):
                verdicts.append(rounds[-1].verdict(chosen, "rejected", after, "held-out"))
                open_causes.remove(chosen)
                continue
            verdicts.append(rounds[-1].verdict(chosen, "found", after))
            rivals = [cause for cause in self._rivals(rounds[-1], open_causes) if cause is not chosen]
            verdicts += [self._indistinguishable(rounds[-1], cause, after, chosen) for cause in rivals]
            open_causes = [cause for cause in open_causes if cause is not chosen and cause not in rivals]
            rounds.append(self._round(after, open_causes))
        verdicts += [self._rejected(rounds, cause) for cause in _best_of_each_kind(rounds[-1], open_causes)]
        return sorted(verdicts, key=_rank), rounds[-1].stand

    def _screened(self, stand: Stand) -> bool:
        """Take out what is grossly wrong against a fitted model, held out or not; return whether there was anything."""
        measured = self._calibration.measured
        rows = stand.fit.whitened.rest[: measured.seen.size * 3 + stand.fit.whitened.problem.local_value.size]
        rest = rows.reshape(len(measured.seen), -1)[:, : 3 * measured.seen.shape[1]]
        wrong = gross_errors(rest.reshape(*measured.seen.shape, 3), measured.seen)
        self._calibration = self._calibration.without(wrong)
        count = int(wrong.sum())
        if self._held_out is not None and stand.held_out is not None:
            unseen = gross_errors(stand.held_out.whitened, self._held_out.measured.seen)
            self._held_out = self._held_out.without(unseen)
            count += int(unseen.sum())
        self.gross += count
        return count > 0

    def _stand(self, causes: tuple[Any, ...], start: Stand | None = None) -> Stand:
        """Return the model with some causes, fitted from an earlier one."""
        self._progress("fitting " + (", ".join(cause.key for cause in causes) or "the plain simulation"))
        model = self._model.with_causes(causes)
        measured, frames = self._calibration.measured, self._calibration.frames
        if start is None:
            shared, local = self._model.widened(np.empty(0), model), np.zeros((len(frames.t), model.local_size))
        else:
            shared, local = start.model.widened(start.fit.shared, model), start.fit.local
            frames = start.fit.frames
        fit = fit_points(model, measured, frames, shared, local)
        error = prediction_error(model, measured, fit.frames, fit.shared, model.unpredicted)
        floor = noise_floor(fit, measured, model.unpredicted, np.random.default_rng(self._settings.seed))
        return Stand(causes, model, fit, error, self._predicted(model, fit), floor)

    def _predicted(self, model: CausalModel, fit: PointFit) -> PredictionError | None:
        if self._held_out is None:
            return None
        held = self._held_out
        return prediction_error(model.at(held.conditions), held.measured, held.frames, fit.shared, model.unpredicted)

    def _round(self, stand: Stand, causes: Sequence[Any]) -> Round:
        """Return what a fitted model leaves for each of the causes."""
        if not causes:
            return Round(stand, {})
        self._progress(f"scoring {len(causes)} candidate causes")
        fit, measured = stand.fit, self._calibration.measured
        signatures = {
            cause.key: project(
                fit.whitened,
                whitened_columns(measured, fit.frames, stand.model.signature(cause, fit.shared, fit.local)),
            )
            for cause in causes
        }
        rng = np.random.default_rng([self._settings.seed, len(stand.causes)])
        scores = Search(fit.whitened, signatures, self._settings.draws, rng).scores()
        level = self._level / len(causes)
        return Round(
            stand,
            {
                name: replace(
                    score,
                    detectable=smallest_detectable(signatures[name], fit.whitened.freedom, level, np.log(RIVAL_FACTOR)),
                )
                for name, score in scores.items()
            },
        )

    def _choose(self, current: Round, causes: Sequence[Any]) -> Any | None:
        """Return the cause to accept: of those that explain the data equally well, named ones before unnamed, the one
        with the fewest parameters."""

        def complexity(cause: Any) -> tuple[bool, int, float]:
            named, count = self._model.is_named(cause), self._model.parameter_count(cause)
            return not named, count, -current.scores[cause.key].log_evidence

        return min(self._rivals(current, causes), key=complexity, default=None)

    def _rivals(self, current: Round, causes: Sequence[Any]) -> list[Any]:
        """Return the significant causes within a factor 20 of the best in evidence.

        None at all is a rival too, with the fewest parameters: what does not beat it by that factor is not accepted.
        """
        scores = {cause: current.scores[cause.key] for cause in causes}
        significant = [cause for cause, score in scores.items() if score.p_value <= self._level]
        best = max((scores[cause].log_evidence for cause in significant), default=0.0)
        least = max(best - np.log(RIVAL_FACTOR), np.log(RIVAL_FACTOR))
        return [cause for cause in significant if scores[cause].log_evidence >= least]

    def _indistinguishable(self, current: Round, cause: Any, accepted: Stand, chosen: Any) -> Verdict:
        own = self._stand((*current.stand.causes, cause), current.stand)
        both = self._stand((*accepted.causes, cause), accepted)
        return replace(current.verdict(cause, "indistinguishable", both, chosen.key), before=accepted, own=own)

    def _rejected(self, rounds: Sequence[Round], cause: Any) -> Verdict:
        """Return the verdict on a cause that the final model does without."""
        last = rounds[-1]
        if last.scores[cause.key].freedom or len(rounds) == 1:
            return last.verdict(cause, "rejected", self._stand((*last.stand.causes, cause), last.stand))
        seen = next((r for r in reversed(rounds) if r.scores[cause.key].freedom), rounds[0])
        own = self._stand((*seen.stand.causes, cause), seen.stand)
        contained = replace(last.verdict(cause, "rejected", last.stand, "contained"), own=own)
        return replace(contained, probability=seen.probabilities[cause.key])


def _best_of_each_kind(current: Round, causes: Sequence[Any]) -> list[Any]:
    """Return of causes with the same id (one effect at several subjects) the most probable."""
    best: dict[str, Any] = {}
    for cause in causes:
        rival = best.setdefault(cause.id, cause)
        if current.scores[cause.key].log_evidence > current.scores[rival.key].log_evidence:
            best[cause.id] = cause
    return list(best.values())


def _predicts_worse(before: PredictionError | None, after: PredictionError | None) -> bool:
    """Return whether held-out poses are predicted significantly worse, pose against pose."""
    if before is None or after is None or len(before.squares) < 2:
        return False
    worse = after.squares - before.squares
    return bool(worse.mean() > _WORSE * worse.std(ddof=1) / np.sqrt(len(worse)) and worse.mean() > 0)


def _rank(verdict: Verdict) -> tuple[int, float]:
    order = ("found", "indistinguishable", "rejected").index(verdict.verdict)
    return order, (0.0 if order == 0 else -verdict.probability)
