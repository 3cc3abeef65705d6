"""Which causes are accepted into a model of observations: forward, the most probable first, everything refitted each
time.

A cause has to be real (the search's p-value), the most probable of those that are (evidence, in pairs where two explain
what a third would swallow), and must not predict held-out epochs worse. In the end each is asked whether the others
could do without it, and what is left whether its size follows something: then everything is weighted and judged anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np

from truing.inference.adequacy import Adequacy, adequacy_of, is_unordered
from truing.inference.arrays import Array, Mask
from truing.inference.attribution import Attributed, attributed
from truing.inference.block_gain import BlockGain, block_gain
from truing.inference.blocks import EpochBlocks
from truing.inference.fitted_model import FittedModel, Fitter, ScreenedValue, residuals_of_inputs
from truing.inference.model import CampaignModel, CauseT, ConditionsLike, ConditionsT, ScatterCandidate
from truing.inference.noise import NoiseDependence, NoiseLevel, noise_level, variance_gain
from truing.inference.observations import Epochs
from truing.inference.prediction import predicts_worse
from truing.inference.rounds import (
    NAMED,
    RIVAL_FACTOR,
    Round,
    is_nonparametric_of_subject,
    score_round,
    share_explained,
)
from truing.inference.scatter import FoundScatter
from truing.inference.search import CauseCandidate, Search
from truing.inference.search_end import MOST_CAUSES, EndOfSearch, end_of_search, limit_reached
from truing.inference.verdicts import (
    FOUND,
    INDISTINGUISHABLE,
    REJECTED,
    SUSPECTED,
    Reason,
    Verdict,
    certain,
    first_order,
    fitted,
)

# Shares of the declared false-alarm rate, so that the rate is kept and not only met: of the search for causes, of noise
# that is larger than declared, of noise that follows something, and of a model that is doubted as a whole.
_CAUSES, _NOISE, _FOLLOWING, _DOUBTED = 0.45, 0.05, 0.1, 0.4
# With a finding predictions may miss by so much more (rms), which is no difference to a reader: of what was fitted, for
# a cause may show in parameters that were improbable without it, and of what was held out.
_NO_MORE, _NO_WORSE = 1.002, 1.02
_MOST_FOLLOWED = 2
_MOST_SCATTERS = 2
_SEVERAL_BURSTS = 2
_MOST_SUBJECTS = 3
# Scatter comes before the best name where its log likelihood exceeds the log odds of that by so much.
_UNSTRUCTURED = 5.0
# Below the first chance of as much order what is larger in places is an effect and no scatter; above the second, noise.
_ORDERED, _SURELY_NOISE = 0.01, 0.05
# So many sigmas to either side it is asked; at most so many times as wide the answer makes a sigma.
_REACH, _WIDEST = 2.0, 4.0


@dataclass(frozen=True)
class Settings:
    """How sure a finding must be, and how the null distribution is drawn."""

    false_alarm: float
    draws: int
    seed: int

    @property
    def level(self) -> float:
        """Return the p-value below which a cause is real."""
        return _CAUSES * self.false_alarm

    @property
    def noise_level(self) -> float:
        """Return the p-value below which noise is larger than declared."""
        return _NOISE * self.false_alarm

    @property
    def dependence_level(self) -> float:
        """Return the p-value below which noise follows something."""
        return _FOLLOWING * self.false_alarm

    @property
    def doubted_level(self) -> float:
        """The p-value below which the final model does not hold as a whole."""
        return _DOUBTED * self.false_alarm


@dataclass(frozen=True)
class CauseDiagnosis(Generic[CauseT]):
    """All verdicts, found ones first; the plain and the final model; all rounds; what was left out."""

    verdicts: tuple[Verdict[CauseT], ...]
    plain: FittedModel[CauseT]
    final: FittedModel[CauseT]
    rounds: tuple[Round[CauseT], ...] = field(repr=False)
    search: Search[CauseT] = field(repr=False)  # the last one, in which nothing was left to be found
    screened: tuple[ScreenedValue, ...]  # observations taken out as gross errors
    noise: NoiseLevel  # what the final model leaves, over what was declared
    noisy: tuple[tuple[int, NoiseLevel], ...]  # single channels with noise of their own that is larger than declared
    noise_dependences: tuple[NoiseDependence, ...]  # what the noise follows; observations were weighted accordingly
    adequacy: Adequacy  # whether the final model holds as a whole
    end: EndOfSearch[CauseT]  # whether the search came to its end
    scatters: tuple[FoundScatter[CauseT], ...]  # what makes inputs scatter; their priors are as wide accordingly
    held_out: Epochs[ConditionsLike] | None
    unasked: tuple[CauseT, ...] = ()  # kinds that have no candidate in this campaign
    blocks: tuple[EpochBlocks, ...] = ()  # groupings of epochs that can be left out block by block
    attributed: tuple[Attributed, ...] = ()  # inputs that predict what is missed, where no model of causes holds


@dataclass(frozen=True)
class _Accepted(Generic[CauseT]):
    """A cause that was accepted: what was chosen, the round in which it was, and the model with it."""

    chosen: CandidateChoice[CauseT]
    round: Round[CauseT]
    cause: CauseT  # in the form that was fitted
    after: FittedModel[CauseT]
    is_outdone: bool  # a form that nobody declared was more probable, but was refused

    @property
    def candidate(self) -> CauseCandidate[CauseT]:
        """Return the candidate that was accepted."""
        return self.chosen.candidate


@dataclass(frozen=True)
class _Searched(Generic[CauseT]):
    """A search from the plain model to one in which nothing is left to be found, or to where it was ended."""

    plain: FittedModel[CauseT]
    kept: list[_Accepted[CauseT]]
    refused: list[Verdict[CauseT]]  # which predict worse, or which the others can do without
    rounds: list[Round[CauseT]]
    final: FittedModel[CauseT]
    end: EndOfSearch[CauseT]

    @property
    def search(self) -> Search[CauseT]:
        """Return the last round's search, which alone is still open."""
        found = self.rounds[-1].search
        assert found is not None
        return found


class CauseSelection(Generic[CauseT]):
    """The search over a catalogue for one campaign; ``run`` returns every verdict and the final model.

    ``given`` are causes that are certain before any search (labels that were exchanged): in every model from the start.
    """

    def __init__(
        self,
        model: CampaignModel[CauseT, ConditionsT],
        calibration: Epochs[ConditionsT],
        held_out: Epochs[ConditionsT] | None,
        settings: Settings,
        progress: Callable[[str], None] = lambda what: None,
        given: Sequence[CauseT] = (),
    ) -> None:
        self._fitter = Fitter(model, calibration, held_out, settings.seed, progress)
        self._settings, self._progress, self._given = settings, progress, tuple(given)

    def run(self, kinds: Sequence[CauseT]) -> CauseDiagnosis[CauseT]:
        """Return what is decided on all kinds of cause of a catalogue."""
        first = self._round(self._fitter.prepared(self._given), kinds, 0)
        noise_dependences = self._noisier_for_a_while(first, kinds)
        if noise_dependences:
            first = self._round(self._fitter.prepared(self._given), kinds, 0)
        outright = None if noise_dependences else self._outright_scatter(first, kinds)
        searched, scatters = self._searched_with_scatter(kinds, first, outright)
        before = len(noise_dependences)
        # What an ended search leaves is more than noise: whether that follows something, it does not tell.
        while searched.end.is_complete and (
            follows := self._noise_dependences(searched.final, kinds, _MOST_FOLLOWED - len(noise_dependences))
        ):
            noise_dependences += follows
            searched = self._searched(kinds)
        later = noise_dependences[before:]
        if scatters and later and (outright is None or any(own.driver.cause is not None for own in later)):
            self._fitter.narrow()  # where observations are noisier, inputs only seemed to scatter
            first = self._round(self._fitter.prepared(self._given), kinds, 0)
            searched, scatters = self._searched_with_scatter(kinds, first)
        fitter, final = self._fitter, searched.final
        noise = noise_level(final.fit.whitened, final.measured, fitter.declared)
        adequacy = adequacy_of(final, noise, np.random.default_rng([self._settings.seed, MOST_CAUSES]), fitter.repeats)
        verdicts = self._verdicts(searched)
        noisy = tuple(self._noisy_channels(final))
        is_noisier = bool(noisy) or noise.p_value <= self._settings.noise_level
        is_noisier |= any(own.driver.cause is None for own in noise_dependences)
        holds = searched.end.is_complete and adequacy.p_value > self._settings.doubted_level and not is_noisier
        # Beside an effect without a name, any name may be a part of it, and what it leaves scatters too. So does what
        # follows nothing that is known: noise that grows at one time may be vibration, at several it is rather that,
        # and so it is where inputs scatter as well.
        bursts = sum(own.driver.cause is not None for own in noise_dependences)
        fewest = 1 if scatters else _SEVERAL_BURSTS
        is_named = all(own.catalogued for own in final.causes) and bursts < fewest
        doubt = Reason.INADEQUATE if not holds else None if is_named else Reason.UNNAMED
        outdone = {step.cause.key for step in searched.kept if step.is_outdone}
        verdicts = [self._doubted(verdict, final, doubt, outdone) for verdict in verdicts]
        is_sure = doubt is None and all(verdict.verdict != SUSPECTED for verdict in verdicts)
        left = "" if is_sure else doubt or Reason.UNNAMED  # what a doubtful model leaves scatters by more than noise
        return CauseDiagnosis(
            tuple(sorted(verdicts, key=lambda verdict: verdict.rank)),
            searched.plain,
            final,
            tuple(searched.rounds),
            searched.search,
            tuple(fitter.screened),
            noise,
            noisy,
            tuple(replace(own, doubt=left or own.doubt) for own in noise_dependences),
            adequacy,
            searched.end,
            tuple(replace(scatter, doubt=left) for scatter in scatters),
            fitter.held_out,
            self._unasked(kinds, searched),
            tuple(fitter.blocks or ()),
            () if holds and (searched.kept or scatters or noise_dependences) else self._attributed(searched.plain),
        )

    def _unasked(self, kinds: Sequence[CauseT], searched: _Searched[CauseT]) -> tuple[CauseT, ...]:
        """Return the kinds of cause of which the campaign has no candidate, neither of an effect nor of scatter."""
        known = {*searched.rounds[0].best, *(cause.id for cause in self._given)}
        scene = searched.plain.scene
        return tuple(kind for kind in kinds if kind.id not in known and not scene.scatters(kind))

    def _attributed(self, plain: FittedModel[CauseT]) -> tuple[Attributed, ...]:
        """Return which inputs predict what the plain model misses: where none holds, names may have swallowed it."""
        self._progress("what the misfit follows")
        return attributed(plain, self._settings.dependence_level)

    def _doubted(
        self, verdict: Verdict[CauseT], final: FittedModel[CauseT], doubt: Reason | None, outdone: set[str]
    ) -> Verdict[CauseT]:
        """A verdict in the whole picture.

        What was found is only suspected where predictions miss by no less with it, or by more on what was held out,
        also beyond the range of what a form without a name follows, or where whole blocks of epochs, predicted from the
        others, are less probable with it. So is a name where the final model does not hold, where it holds an effect
        without a name, of which the name may be a part, or where a form without a name explained more but did not
        predict.
        """
        if verdict.verdict != FOUND:
            return verdict
        before, after = verdict.held_out
        held_out = 1.0 if before is None or after is None else after.growth_over(before)
        pays = verdict.signal_to_noise > 0.0 and verdict.after.growth_over(verdict.before) <= _NO_MORE
        if not pays and held_out > 1.0 / _NO_WORSE:  # what happened in held-out epochs alone lowers only their errors
            return replace(verdict, verdict=SUSPECTED, reason=Reason.UNPAID)
        if held_out > _NO_WORSE:
            return replace(verdict, verdict=SUSPECTED, reason=Reason.HELD_OUT)
        if verdict.block_gain is not None and verdict.block_gain.log_gain < -np.log(RIVAL_FACTOR):
            return replace(verdict, verdict=SUSPECTED, reason=Reason.ELSEWHERE)
        if not verdict.cause.catalogued or verdict.cause in self._given:
            return verdict
        verdict = replace(verdict, share_explained=share_explained(final, verdict.cause))
        if doubt is None and verdict.cause.key not in outdone:
            return verdict
        return replace(verdict, verdict=SUSPECTED, reason=doubt or Reason.UNNAMED)

    def _noisy_channels(self, final: FittedModel[CauseT]) -> Iterator[tuple[int, NoiseLevel]]:
        """Yield the channels of an instrument whose noise is larger than declared, p-values corrected for their number;
        of single observations there are too few to tell."""
        own = np.flatnonzero(final.measured.seen.any(0)) if final.measured.size == 1 else ()
        for channel in own:
            only = np.arange(final.measured.seen.shape[1]) == channel
            level = noise_level(final.fit.whitened, final.measured, self._fitter.declared, only)
            if (p_value := min(1.0, level.p_value * len(own))) <= self._settings.noise_level:
                yield int(channel), replace(level, p_value=p_value)

    def _noisier_for_a_while(self, first: Round[CauseT], kinds: Sequence[CauseT]) -> list[NoiseDependence]:
        """Weight observations that are noisier for a while, where that is far more probable than any name, and no
        scatter of inputs makes them seem so."""
        if self._scatter(first.fitted, kinds) is not None:
            return []
        found = self._fitter.noise_dependence(first.fitted, kinds, self._settings.dependence_level)
        if found is None or found.driver.cause is None:
            return []
        if not self._outdoes_names(self._fitter.known_residuals(first.fitted), found.driver.values > 0.5, first):
            return []
        return [self._weighed(first.fitted, found)]

    def _outright_scatter(
        self, first: Round[CauseT], kinds: Sequence[CauseT]
    ) -> tuple[ScatterCandidate[CauseT], float] | None:
        """Return the cause that makes inputs scatter and its p-value, where it is far more probable than any name."""
        found, rest = self._scatter(first.fitted, kinds), residuals_of_inputs(first.fitted).standardised
        return found if found is not None and self._outdoes_names(rest, found[0].own, first) else None

    def _searched_with_scatter(
        self,
        kinds: Sequence[CauseT],
        first: Round[CauseT],
        outright: tuple[ScatterCandidate[CauseT], float] | None = None,
    ) -> tuple[_Searched[CauseT], list[FoundScatter[CauseT]]]:
        """Return the search beside inputs that scatter, from the first round on, and what makes them: ``outright`` is
        asked for before any name."""
        scatters: list[FoundScatter[CauseT]] = []
        if outright is not None:
            searched, scatter = self._with_input_scatter(*outright, first.fitted, kinds)
            scatters.append(scatter)
        else:
            searched = self._searched(kinds, first)
        while searched.end.is_complete and len(scatters) < _MOST_SCATTERS:
            if (more := self._scatter(searched.final, kinds)) is None:
                break
            searched, scatter = self._with_input_scatter(*more, searched.plain, kinds)
            scatters.append(scatter)
        return searched, scatters

    def _outdoes_names(self, rest: Array, own: Mask, first: Round[CauseT]) -> bool:
        """Whether standardised residuals (B, K, d) that are larger in some places (B, K) are far more probable than the
        best name, and without order there.

        Names taken first would each swallow some of the scatter: the data then seem to hold several of them.
        """
        gain = rest.shape[-1] * variance_gain(np.mean(rest**2, -1), own)
        real = (c for c in first.best.values() if is_real(first, c, self._settings.level))
        if gain <= max((first.posterior(c) for c in real), default=0.0) + _UNSTRUCTURED:
            return False
        return is_unordered(rest, own, first.fitted, _ORDERED)

    def _scatter(
        self, final: FittedModel[CauseT], kinds: Sequence[CauseT]
    ) -> tuple[ScatterCandidate[CauseT], float] | None:
        return self._fitter.scatter(final, kinds, self._settings.dependence_level)

    def _with_input_scatter(
        self, candidate: ScatterCandidate[CauseT], p_value: float, plain: FittedModel[CauseT], kinds: Sequence[CauseT]
    ) -> tuple[_Searched[CauseT], FoundScatter[CauseT]]:
        """Return the search beside inputs that scatter, and their scatter.

        All that the plain model leaves of them counts as scatter: names that were found before may have swallowed some
        of it, and one that is there is found beside it.
        """
        candidate = self._fitter.widen(plain, candidate, kinds)
        searched = self._searched(kinds)
        return searched, self._fitter.input_scatter(searched.final, candidate, p_value)

    def _weighed(self, fitted: FittedModel[CauseT], found: NoiseDependence) -> NoiseDependence:
        """Weight observations by what their noise follows; a cause of it is doubted where that may have an order."""
        own, rest = found.driver.values > 0.5, self._fitter.known_residuals(fitted)
        is_noise = found.driver.cause is None or is_unordered(rest, own, fitted, _SURELY_NOISE)
        return replace(self._fitter.weigh(fitted, found), doubt="" if is_noise else Reason.UNNAMED)

    def _noise_dependences(
        self, final: FittedModel[CauseT], kinds: Sequence[CauseT], most: int
    ) -> list[NoiseDependence]:
        """Return what the noise follows, one after the other, each time with the same causes fitted to observations
        that are weighted accordingly: only once nothing more is found is it worth a search."""
        found: list[NoiseDependence] = []
        level = self._settings.dependence_level
        while len(found) < most and (more := self._fitter.noise_dependence(final, kinds, level)):
            found.append(self._weighed(final, more))
            if len(found) < most:
                final = self._fitter.converged(final.causes, final)
        return found

    def _searched(self, kinds: Sequence[CauseT], first: Round[CauseT] | None = None) -> _Searched[CauseT]:
        """The search from the plain model on, whose round may be known already."""
        rounds = [first or self._round(self._fitter.prepared(self._given), kinds, 0)]
        plain = rounds[0].fitted
        found, worse, end = self._forward(rounds, kinds)
        kept, dropped, final = self._dropped(found, plain)
        return _Searched(plain, kept, [*worse, *dropped], rounds, final, end)

    def _verdicts(self, searched: _Searched[CauseT]) -> list[Verdict[CauseT]]:
        """Return one verdict per kind of cause, and one per further subject that was found."""
        final, held_out = searched.final, self._fitter.held_out
        verdicts = [certain(cause, searched.plain, held_out) for cause in self._given]
        for step in searched.kept:
            plain = first_order(step.round, step.candidate, FOUND, held_out)
            reported = fitted(plain, step.cause, step.round.fitted, step.after, final)
            size = step.candidate.signature.parameters
            spread = both_sides(self._fitter, final, step.cause, size)
            blocks = self._fitter.blocks
            gain = gain_in_blocks(final, step.cause, size, blocks or ())
            reported = replace(reported, covariance=reported.covariance * spread, subjects=step.chosen.subjects)
            verdicts.append(replace(reported, blocks_asked=blocks is not None, block_gain=gain))
        others = [*self._rivals(searched.kept), *searched.refused, *self._rejected(searched.rounds, searched.end)]
        for verdict in others:  # one row per cause: the first thing that is to be said of it
            if verdict.cause.id not in {reported.cause.id for reported in verdicts}:
                verdicts.append(verdict)
        return verdicts

    def _round(self, fitted: FittedModel[CauseT], kinds: Sequence[CauseT], number: int) -> Round[CauseT]:
        self._progress(f"scoring the candidates of {len(kinds)} kinds of cause")
        return score_round(fitted, kinds, self._settings.draws, np.random.default_rng([self._settings.seed, number]))

    def _forward(
        self, rounds: list[Round[CauseT]], kinds: Sequence[CauseT]
    ) -> tuple[list[_Accepted[CauseT]], list[Verdict[CauseT]], EndOfSearch[CauseT]]:
        """Return the causes accepted one after the other, those that predict worse, and how it ended; adds rounds."""
        found: list[_Accepted[CauseT]] = []
        worse: list[Verdict[CauseT]] = []
        pairs = True
        while True:
            current, refused = rounds[-1], {verdict.cause.id for verdict in worse}
            chosen = choose(current, refused, self._settings.level, pairs=pairs)
            accepted = [step.cause for step in found]
            if (limit := limit_reached(accepted)) is not None or chosen is None:
                left = None if chosen is None else chosen.candidate.cause
                return found, worse, end_of_search(limit, accepted, current, left)
            chosen, cause, after = self._fitted(chosen, current)
            if predicts_worse(current.fitted.held_out, after.held_out, self._covered(cause, after)):
                worse.append(first_order(current, chosen.candidate, REJECTED, self._fitter.held_out, Reason.HELD_OUT))
                continue
            next_round = self._round(after, kinds, len(rounds))
            pairs = not chosen.of_two or confirmed(current, chosen, next_round, self._settings.level, refused)
            if not pairs:
                continue
            rounds[-1] = current.closed()
            outdone = is_outdone(current, chosen.candidate, refused)
            found.append(_Accepted(chosen.light(), rounds[-1], cause, after, outdone))
            rounds.append(next_round)

    def _fitted(
        self, chosen: CandidateChoice[CauseT], current: Round[CauseT]
    ) -> tuple[CandidateChoice[CauseT], CauseT, FittedModel[CauseT]]:
        """Return what was chosen in the form that is fitted, and the model with it; without those of its parts that do
        nothing then."""
        while True:
            own = chosen.candidate.cause
            cause, size = own.refined(), chosen.candidate.signature.parameters
            after = self._fitter.prepared((*current.fitted.causes, cause), current.fitted)
            values, covariance = after.values(cause)
            least = own.narrowed(values[:size], covariance[:size, :size], after.model.part_count)
            narrower = next((c for c in current.candidates if c.key == least.key), chosen.candidate)
            if narrower is chosen.candidate or not is_real(current, narrower, self._settings.level):
                return chosen, cause, after
            chosen = replace(chosen, candidate=narrower, subjects=())

    def _covered(self, cause: CauseT, after: FittedModel[CauseT]) -> Mask:
        """Return at which held-out epochs (B,) a cause claims to hold."""
        held = self._fitter.held_out
        if held is None:
            return np.ones(len(after.measured.seen), bool)
        return np.asarray(cause.covers(held.conditions.covariates, len(held.measured.seen)))

    def _dropped(
        self, found: list[_Accepted[CauseT]], plain: FittedModel[CauseT]
    ) -> tuple[list[_Accepted[CauseT]], list[Verdict[CauseT]], FittedModel[CauseT]]:
        """Return what is kept once every accepted cause had to show that the others cannot do without it."""
        final, kept = found[-1].after if found else plain, list(found)
        dropped: list[Verdict[CauseT]] = []
        for step in found[:-1]:
            if len(kept) > 1 and not self._is_needed(step, final, [other.cause for other in kept if other is not step]):
                kept.remove(step)
                dropped.append(first_order(step.round, step.candidate, REJECTED, self._fitter.held_out, Reason.DROPPED))
                final = self._fitter.prepared((*self._given, *(other.cause for other in kept)), final)
        return kept, dropped, final

    def _is_needed(self, step: _Accepted[CauseT], final: FittedModel[CauseT], others: Sequence[CauseT]) -> bool:
        """Return whether an accepted cause is still real in the final model, at the search's threshold: by Wald's test,
        or by what a fit of the others without it leaves, since a shape that the data hardly tell widens amplitudes."""
        values, covariance = final.values(step.cause)
        size = step.candidate.signature.parameters
        null = step.round.null
        group = null.group_of(step.candidate.kind, step.candidate.signature.rank)
        limit = null.threshold(group, self._settings.level)
        squares = float(values[:size] @ np.linalg.solve(covariance[:size, :size], values[:size]))
        if null.raw(squares, group, 1.0) <= limit:
            return True
        if step.cause.key == step.candidate.key:  # no shape of its own
            return False
        without = self._fitter.fitted((*self._given, *others), final)
        gained = float(np.sum(without.fit.whitened.rest**2) - np.sum(final.fit.whitened.rest**2))
        return bool(null.raw(gained / final.noise_ratio**2, group, 1.0) <= limit)

    def _rivals(self, kept: Sequence[_Accepted[CauseT]]) -> list[Verdict[CauseT]]:
        """Return the kinds that explain what was found as well, which the campaign cannot tell from it."""
        found, held_out = [], self._fitter.held_out
        for step in kept:
            for rival, lead in step.chosen.rivals:
                if rival.kind != step.candidate.kind and _is_worth_reporting(rival, lead):
                    own = self._fitter.fitted((*step.round.fitted.causes, rival.cause.refined()), step.round.fitted)
                    plain = first_order(step.round, rival, INDISTINGUISHABLE, held_out, Reason.RIVAL)
                    odds = step.round.posterior(step.candidate) + lead
                    found.append(replace(plain, own=own, log_odds=odds, rival=step.cause))
        return found

    def _rejected(self, rounds: Sequence[Round[CauseT]], end: EndOfSearch[CauseT]) -> list[Verdict[CauseT]]:
        """Return the verdicts on the best of every kind that the final model does without.

        What speaks for them is told of the first round, where they competed with what was found.
        """
        closing, first, found = rounds[-1], rounds[0], []
        for kind, candidate in closing.best.items():
            before = first.best.get(kind)
            if candidate.signature.rank or before is None or not before.signature.rank:
                reason = Reason.CHANCE if candidate.signature.rank else Reason.UNSEEN
                if not end.is_complete and is_real(closing, candidate, self._settings.level):
                    reason = Reason.ENDED
                verdict = first_order(closing, candidate, REJECTED, self._fitter.held_out, reason)
            else:
                verdict = first_order(first, before, REJECTED, self._fitter.held_out, Reason.CONTAINED)
            found.append(verdict if before is None else replace(verdict, log_odds=first.posterior(before)))
        return found


def _is_worth_reporting(rival: CauseCandidate[CauseT], lead: float) -> bool:
    """Return whether a rival is worth telling: a form that nobody declared only where it is not the less probable."""
    return rival.cause.catalogued or lead >= 0.0


@dataclass(frozen=True)
class CandidateChoice(Generic[CauseT]):
    """The candidate to accept, and which ones the data cannot tell from it, with their log odds over it.

    ``of_two``: it is accepted as one of two that together explain what one would swallow; ``subjects``: what else it
    may concern, with the odds against each.
    """

    candidate: CauseCandidate[CauseT]
    rivals: tuple[tuple[CauseCandidate[CauseT], float], ...]
    of_two: bool = False
    subjects: tuple[tuple[str, float], ...] = ()

    def light(self) -> CandidateChoice[CauseT]:
        """Return it without designs, which only a search needs."""
        rivals = tuple((rival.light(), lead) for rival, lead in self.rivals)
        return replace(self, candidate=self.candidate.light(), rivals=rivals)


def choose(
    current: Round[CauseT], refused: set[str], level: float, *, pairs: bool = True
) -> CandidateChoice[CauseT] | None:
    """Return the candidate to accept: of the kinds that explain the data equally well the one with the fewest
    parameters, a named one unless no name is more probable; where two together explain what one would swallow, the
    stronger of them, whose rivals are those that do as well beside the other.

    None where nothing is real, at the p-value ``level``, that is not of a kind among ``refused``: what is out for
    another reason sets no standard that the others would have to meet.
    """
    rivals = _equals(current, level, refused)
    if not rivals:
        return None
    pair = current.best_pair if pairs else None
    if pair is not None and pair.first.kind not in refused and _leads(current, pair.first, level):
        also = tuple(own for own in pair.rivals if is_real(current, own[0], level))
        return CandidateChoice(pair.first, also, True, _other_subjects(current, pair.first))
    unnamed = [c for c in rivals if not c.cause.catalogued]
    least = max((current.posterior(c) for c in unnamed), default=-np.inf) - NAMED
    named = [c for c in rivals if c.cause.catalogued and current.posterior(c) >= least]
    chosen = min(named or unnamed, key=lambda c: (c.signature.parameters, -current.posterior(c)), default=None)
    if chosen is None:
        return None
    also = tuple((c, current.posterior(c) - current.posterior(chosen)) for c in rivals)
    return CandidateChoice(chosen, also, False, _other_subjects(current, chosen))


def confirmed(
    current: Round[CauseT], choice: CandidateChoice[CauseT], next_round: Round[CauseT], level: float, refused: set[str]
) -> bool:
    """Return whether what was chosen as one of two, and the best beside it once everything was fitted anew, are still
    more probable than any single one that was not refused: before, the evidence of two is an estimate.

    So is that of a single one, which is linear in the effect; what leaves nothing real beside it needs no other.
    """
    left = next_round.best.values()
    if not any(is_real(next_round, c, level) for c in left):
        return True
    alone = max(current.posterior(c) for kind, c in current.best.items() if kind not in refused)
    beside = max((next_round.posterior(c) for c in left), default=0.0)
    return bool(current.posterior(choice.candidate) + beside >= alone + np.log(RIVAL_FACTOR))


def is_real(current: Round[CauseT], candidate: CauseCandidate[CauseT], level: float) -> bool:
    """Return whether chance is ruled out, and the data speak for the cause rather than for none.

    The second is no matter of course: many parameters may be far from zero together, and of no plausible size in any
    direction.
    """
    speaks = current.scores[candidate.key].log_evidence > 0.0
    return speaks and current.p_value(candidate) <= level


def is_outdone(current: Round[CauseT], chosen: CauseCandidate[CauseT], refused: set[str]) -> bool:
    """Whether a form that nobody declared is more probable than a name, though one of its kind was refused."""
    unnamed = (c for c in current.candidates if not c.cause.catalogued and c.kind in refused)
    least = current.posterior(chosen) + NAMED
    return chosen.cause.catalogued and any(current.posterior(candidate) > least for candidate in unnamed)


def _equals(current: Round[CauseT], level: float, refused: set[str]) -> list[CauseCandidate[CauseT]]:
    """Return the best candidates of those kinds that stand and are within a factor 20 of the best in evidence."""
    real = [c for c in current.best.values() if c.kind not in refused and _holds_up(current, c, level)]
    best = max((current.posterior(c) for c in real), default=0.0)
    return [c for c in real if current.posterior(c) >= best - np.log(RIVAL_FACTOR)]


def _holds_up(current: Round[CauseT], candidate: CauseCandidate[CauseT], level: float) -> bool:
    """Return whether a candidate is real, and a name no remainder of a form that nobody declared.

    Such forms are rough, so that something is left of them: beside one, a name has to be told from its further terms,
    real or not, from other forms of its subject, and from chance, and must not be small beside it where it acts on the
    same.
    """
    if not is_real(current, candidate, level):
        return False
    forms = [cause for cause in current.fitted.causes if not cause.catalogued]
    if not candidate.cause.catalogued or not forms:
        return True
    reported = {cause.subject for cause in forms if cause.subject}  # what concerns all is about nothing in particular
    unnamed = [c for c in current.candidates if not c.cause.catalogued]
    rests = (current.posterior(c) for c in unnamed if c.cause.is_higher_order or c.cause.subject in reported)
    least = max(max(rests, default=0.0), 0.0) + float(np.log(RIVAL_FACTOR))
    return current.posterior(candidate) >= least and not current.is_remainder(candidate)


def _leads(current: Round[CauseT], first: CauseCandidate[CauseT], level: float) -> bool:
    """Return whether the first of a pair is accepted: beside forms of a subject as if it came alone."""
    if any(is_nonparametric_of_subject(cause) for cause in current.fitted.causes):
        return _holds_up(current, first, level)
    return is_real(current, first, level)


def _other_subjects(current: Round[CauseT], chosen: CauseCandidate[CauseT]) -> tuple[tuple[str, float], ...]:
    """Return what else a named cause may concern, the most probable first, with the odds against each."""
    if not chosen.cause.catalogued:
        return ()
    logs: dict[str, float] = {}
    for candidate in current.candidates:
        if candidate.kind == chosen.kind:
            own = candidate.cause.subject
            logs[own] = float(np.logaddexp(logs.get(own, -np.inf), current.posterior(candidate)))
    best = logs.pop(chosen.cause.subject)
    near = sorted((best - log, subject) for subject, log in logs.items() if best - log < np.log(RIVAL_FACTOR))
    return tuple((subject, float(np.exp(against))) for against, subject in near[:_MOST_SUBJECTS])


def gain_in_blocks(
    final: FittedModel[CauseT], cause: CauseT, size: int, possible: Sequence[EpochBlocks]
) -> BlockGain | None:
    """Return by how much a cause of the final model pays in blocks that are left out; all of its parameters but the
    first ``size`` are its shape. None where no kind of block tells."""
    place = final.model.layout[cause.key]
    linear = np.arange(place.stop - place.start) < size
    return block_gain(final.fit.whitened, place, np.where(linear, final.fit.shared[place], 0.0), possible)


def both_sides(fitter: Fitter[CauseT], final: FittedModel[CauseT], cause: CauseT, size: int) -> Array:
    """Return factors (P, P) on the covariance of a cause in the final model, all of whose parameters but the first
    ``size`` are its shape: those that make sigmas of shapes what the wider side's rise of the sum of squares says."""
    values, covariance = final.values(cause)
    wider = np.ones(len(values))
    for place in range(size, len(values)):
        step = _REACH * np.sqrt(covariance[place, place]) * (np.arange(len(values)) == place)
        held = [cause.with_fixed_shape((values + way * step)[size:]) for way in (-1.0, 1.0)]
        rises = [_rise(fitter, final, cause, own) for own in held if own is not None]
        least = min((np.sqrt(max(rise, 0.0)) for rise in rises), default=_REACH)
        wider[place] = np.clip(_REACH / max(least, 1e-9), 1.0, _WIDEST)
    return np.outer(wider, wider)


def _rise(fitter: Fitter[CauseT], final: FittedModel[CauseT], cause: CauseT, held: CauseT) -> float:
    """Return by how much the sum of squares rises, in those of the noise, where a cause's shape is held."""
    causes = tuple(held if other is cause else other for other in final.causes)
    without = fitter.fitted(causes, final)
    return float(np.sum(without.fit.whitened.rest**2) - np.sum(final.fit.whitened.rest**2)) / final.noise_ratio**2
