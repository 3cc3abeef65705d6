"""Forward selection of causes: accept the most probable one, refit everything, repeat.

An accepted candidate is significant in the search over all candidates. It is the most probable one by evidence, in
pairs where two explain what a third would absorb. It does not predict held-out epochs worse; after many causes, it
predicts them better. At the end each accepted cause is dropped if the others explain its effect. If the noise depends
on something, observations are weighted accordingly and the search is repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np

from truing.inference import search_end
from truing.inference.adequacy import Adequacy, adequacy_of
from truing.inference.arrays import Mask
from truing.inference.attribution import Attributed, attributed
from truing.inference.block_gain import gain_in_blocks
from truing.inference.blocks import EpochBlocks
from truing.inference.choice import CandidateChoice, choose, confirmed, is_outdone, is_real, is_worth_reporting
from truing.inference.fitted_model import FittedModel, Fitter, ScreenedValue
from truing.inference.free_course import CourseRival, course_rival, move_alike
from truing.inference.model import CampaignModel, CauseT, ConditionsLike, ConditionsT, ScatterCandidate
from truing.inference.noise import NoiseDependence, NoiseLevel, noise_level
from truing.inference.noise_selection import NoiseSelection
from truing.inference.observations import Epochs
from truing.inference.prediction import predicts_worse
from truing.inference.rounds import RIVAL_FACTOR, Round, act_on_same, score_round, share_explained
from truing.inference.scatter import FoundScatter
from truing.inference.search import CauseCandidate, Search
from truing.inference.search_end import EndOfSearch, FurtherCauses
from truing.inference.several_names import several_for_one
from truing.inference.shape_uncertainty import shape_covariance_factors
from truing.inference.verdicts import (
    FOUND,
    INDISTINGUISHABLE,
    REJECTED,
    SUSPECTED,
    Reason,
    Verdict,
    accepted,
    first_order,
    verdict_on_known_cause,
)

# Shares of the declared false-alarm rate: search for causes, noise larger than declared, noise that depends on
# something, and doubt of the whole model.
_CAUSES, _NOISE, _DEPENDENCE, _DOUBTED = 0.45, 0.05, 0.1, 0.4
# Largest growth of the rms error with a finding, on fitted and on held-out epochs. It may grow slightly on fitted ones,
# since without the cause other parameters take improbable values.
_NO_MORE, _NO_WORSE = 1.002, 1.02
_MOST_DEPENDENCES = 2
_MOST_SCATTERS = 2
_SEVERAL_PERIODS = 2
# Probability from which on a name is found, among all that explain the same.
_NAMED = 0.9
_LEVEL_OF_COURSE = 0.05  # of a model that does not hold: odds of 20 to 1 that a course follows an input
_ADEQUACY = 8  # stream of random numbers


@dataclass(frozen=True)
class Settings:
    """Accepted rate of false alarms, and the draws of the null distribution."""

    false_alarm: float
    draws: int
    seed: int

    @property
    def level(self) -> float:
        """p-value below which a cause is real."""
        return _CAUSES * self.false_alarm

    @property
    def noise_level(self) -> float:
        """p-value below which the noise is larger than declared."""
        return _NOISE * self.false_alarm

    @property
    def dependence_level(self) -> float:
        """p-value below which the noise depends on something."""
        return _DEPENDENCE * self.false_alarm

    @property
    def doubted_level(self) -> float:
        """p-value below which the final model does not hold as a whole."""
        return _DOUBTED * self.false_alarm


@dataclass(frozen=True)
class CauseDiagnosis(Generic[CauseT]):
    """Result of a search: all verdicts, found ones first; the plain and the final model; all rounds; excluded
    observations."""

    verdicts: tuple[Verdict[CauseT], ...]
    plain: FittedModel[CauseT]
    final: FittedModel[CauseT]
    rounds: tuple[Round[CauseT], ...] = field(repr=False)
    search: Search[CauseT] = field(repr=False)  # the last one
    screened: tuple[ScreenedValue, ...]  # observations excluded as gross errors
    noise: NoiseLevel  # noise of the final model's residuals over the declared one
    noisy: tuple[tuple[int, NoiseLevel], ...]  # single channels with noise larger than declared
    noise_dependences: tuple[NoiseDependence, ...]  # observations were weighted accordingly
    adequacy: Adequacy  # tests of the final model as a whole
    end: EndOfSearch[CauseT]  # reason why the search stopped
    scatters: tuple[FoundScatter[CauseT], ...]  # causes that make inputs scatter; priors were widened accordingly
    held_out: Epochs[ConditionsLike] | None
    unasked: tuple[CauseT, ...] = ()  # kinds that have no candidate in this campaign
    blocks: tuple[EpochBlocks, ...] = ()  # groupings of epochs that can be left out block by block
    attributed: tuple[Attributed, ...] = ()  # inputs that predict the residuals, where no model of causes holds
    has_repeats: bool = True  # whether inputs were repeated, so that scatter differs from an effect of fine pattern


@dataclass(frozen=True)
class _Accepted(Generic[CauseT]):
    """An accepted cause: the choice, its round, and the models without it and with it."""

    chosen: CandidateChoice[CauseT]
    round: Round[CauseT]
    cause: CauseT  # in the form that was fitted
    before: FittedModel[CauseT]  # the model without it
    after: FittedModel[CauseT]
    is_outdone: bool  # a nonparametric effect was more probable, but was refused
    choice: float  # evidence averaged over its shapes on its subject, relative to its own
    probability: float  # of its kind among all that explain the same

    @property
    def candidate(self) -> CauseCandidate[CauseT]:
        """Candidate that was accepted."""
        return self.chosen.candidate


@dataclass(frozen=True)
class _Searched(Generic[CauseT]):
    """Result of one search from the plain model on."""

    plain: FittedModel[CauseT]
    kept: list[_Accepted[CauseT]]
    refused: list[Verdict[CauseT]]  # they predict worse, or the others explain their effect
    rounds: list[Round[CauseT]]
    final: FittedModel[CauseT]
    end: EndOfSearch[CauseT]

    @property
    def search(self) -> Search[CauseT]:
        """Search of the last round, the only one that is not closed."""
        found = self.rounds[-1].search
        assert found is not None
        return found


class CauseSelection(Generic[CauseT]):
    """Search over a catalogue of causes for one campaign; ``run`` returns every verdict and the final model.

    ``given`` are causes known before any search, such as exchanged labels; every model holds them.
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
        self._noise = NoiseSelection(self._fitter, settings.level, settings.noise_level, settings.dependence_level)

    def run(self, kinds: Sequence[CauseT]) -> CauseDiagnosis[CauseT]:
        """Return the diagnosis over all kinds of cause of a catalogue."""
        rounds = self._first_round(kinds)
        noise_dependences = self._noise.noisy_periods(rounds[0], kinds)
        if noise_dependences:
            rounds = self._first_round(kinds)
        outright = None if noise_dependences else self._noise.outright_scatter(rounds[0], kinds)
        searched, scatters = self._searched_with_scatter(kinds, rounds, outright)
        before = len(noise_dependences)
        # A search that reached a limit leaves more than noise, so its residuals cannot show on what the noise depends.
        while searched.end.is_complete and (
            found := self._noise.dependences(searched.final, kinds, _MOST_DEPENDENCES - len(noise_dependences))
        ):
            noise_dependences += found
            searched = self._searched(kinds)
        later = noise_dependences[before:]
        if scatters and later and (outright is None or any(own.driver.cause is not None for own in later)):
            self._fitter.narrow()  # noisier observations explain the apparent scatter of inputs
            searched, scatters = self._searched_with_scatter(kinds, self._first_round(kinds))
        searched, verdicts = self._paying(searched)
        fitter, final = self._fitter, searched.final
        noise = noise_level(final.fit.whitened, final.measured, fitter.declared)
        adequacy = adequacy_of(final, noise, np.random.default_rng([self._settings.seed, _ADEQUACY]), fitter.repeats)
        noisy = tuple(self._noise.noisy_channels(final))
        is_noisier = bool(noisy) or noise.p_value <= self._settings.noise_level
        is_noisier |= any(own.driver.cause is None for own in noise_dependences)
        holds = searched.end.is_complete and adequacy.p_value > self._settings.doubted_level and not is_noisier
        # If the model holds a nonparametric effect, any catalogued cause may be a part of it. The same doubt holds if
        # noise is larger in several periods, or in one while inputs scatter: an unknown effect is then more likely. So
        # it is where larger noise is not random.
        periods = sum(own.driver.cause is not None for own in noise_dependences)
        fewest = 1 if scatters else _SEVERAL_PERIODS
        is_named = all(own.catalogued for own in final.causes) and periods < fewest
        is_named &= not any([own.doubt for own in noise_dependences] + [own.doubt for own in scatters])
        outdone, rivals = self._outdone(searched, verdicts, compares_courses=holds and is_named)
        is_clear = holds and is_named and not outdone and all(verdict.verdict != SUSPECTED for verdict in verdicts)
        attributions = () if is_clear and searched.kept else self._attributed(searched, holds=holds)
        # What inputs predict is no scatter, though it may pass for one.
        is_named &= bool(searched.kept) or not attributions
        doubt = Reason.INADEQUATE if not holds else None if is_named else Reason.UNNAMED
        steps = {step.cause.key: step for step in searched.kept if not step.cause.catalogued}
        weak = of_larger_noise(steps, verdicts, noise.ratio, self._settings.level) if is_noisier else set()
        verdicts = [self._checked_verdict(verdict, final, doubt, outdone, rivals, weak) for verdict in verdicts]
        # Where only the name is open the model is right all the same.
        is_sure = doubt is None and all(v.verdict != SUSPECTED or v.reason is Reason.ALTERNATIVE for v in verdicts)
        left = "" if is_sure else doubt or Reason.UNNAMED  # residuals of a doubtful model hold more than noise
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
            tuple(replace(scatter, doubt=left or scatter.doubt) for scatter in scatters),
            fitter.held_out,
            self._untestable_kinds(kinds, searched),
            tuple(fitter.blocks or ()),
            attributions,
            fitter.repeats is not None,
        )

    def _untestable_kinds(self, kinds: Sequence[CauseT], searched: _Searched[CauseT]) -> tuple[CauseT, ...]:
        """Return the kinds of cause without any candidate in this campaign, neither of an effect nor of scatter."""
        known = {*searched.rounds[0].best, *(cause.id for cause in self._given)}
        scene = searched.plain.scene
        return tuple(kind for kind in kinds if kind.id not in known and not scene.scatters(kind))

    def _attributed(self, searched: _Searched[CauseT], *, holds: bool) -> tuple[Attributed, ...]:
        """Return the inputs that predict residuals of the plain model; a model with wrong causes may have absorbed
        them. If the final model does not hold, the campaign is known to hold something else, and a larger level
        suffices. Its own residuals are asked too: what it explains no longer hides the rest."""
        self._progress("what the misfit follows")
        if holds:
            return attributed((searched.plain,), self._settings.dependence_level, self._settings.dependence_level)
        models = (searched.plain, searched.final) if searched.kept else (searched.plain,)
        return attributed(models, self._settings.doubted_level, _LEVEL_OF_COURSE)

    def _is_incomplete(self, step: _Accepted[CauseT], searched: _Searched[CauseT]) -> bool:
        """Return True if nonparametric rivals of an accepted cause still explain something next to it."""
        last = searched.rounds[-1]
        return last.p_value_of_rivals(step.candidate, step.round) <= self._settings.dependence_level

    def _outdone(
        self, searched: _Searched[CauseT], verdicts: Sequence[Verdict[CauseT]], *, compares_courses: bool
    ) -> tuple[set[str], dict[str, CourseRival]]:
        """Return the keys of accepted causes beside or in place of which an effect without a name may act, and the
        random courses among these effects."""
        outdone = {step.cause.key for step in searched.kept if step.is_outdone or self._is_incomplete(step, searched)}
        outdone |= self._several_for_one(searched)
        rivals = self._course_rivals(searched, outdone) if compares_courses else {}
        outdone |= self._beside_refused(searched, verdicts)
        return outdone | rivals.keys() | self._smaller(searched, rivals.keys()), rivals

    def _course_rivals(self, searched: _Searched[CauseT], outdone: set[str]) -> dict[str, CourseRival]:
        """Return the random courses that compete with accepted causes, by their keys; none for the causes that clearly
        beat them."""
        found: dict[str, CourseRival] = {}
        for step in searched.kept:
            if step.cause.catalogued and step.cause.has_law and step.cause.key not in outdone:
                self._progress(f"random courses in place of {step.cause.id}")
                without = self._without_cause(searched, step.cause.key)
                size = step.candidate.signature.parameters
                rival = course_rival(searched.final, without, step.cause, size, step.choice)
                if rival is not None and not rival.is_clear:
                    found[step.cause.key] = rival
        return found

    @staticmethod
    def _several_for_one(searched: _Searched[CauseT]) -> set[str]:
        """Return the keys of accepted causes that may be a single effect without a name."""
        sizes = {step.cause.key: step.candidate.signature.parameters for step in searched.kept}

        def alike(first: CauseT, second: CauseT) -> bool:
            return move_alike(searched.final, (first, sizes[first.key]), (second, sizes[second.key]))

        accepted = [(step.cause, step.candidate, step.round) for step in searched.kept]
        return several_for_one(accepted, searched.rounds[-1], alike)

    @staticmethod
    def _beside_refused(searched: _Searched[CauseT], verdicts: Sequence[Verdict[CauseT]]) -> set[str]:
        """Return the keys of accepted causes that act on the same as a nonparametric effect which is significant next
        to them, but predicts held-out epochs worse: something is there, in another form."""
        worse = [own for own in searched.refused if own.reason is Reason.HELD_OUT]
        worse += [own for own in verdicts if own.verdict == SUSPECTED]
        refused = [own.cause for own in worse if not own.cause.catalogued]
        named = [step.cause for step in searched.kept if step.cause.catalogued]
        return {cause.key for cause in named if any(act_on_same(searched.final, cause, own) for own in refused)}

    @staticmethod
    def _smaller(searched: _Searched[CauseT], doubted: Collection[str]) -> set[str]:
        """Return the keys of accepted causes that are smaller than one of those ``doubted``: what a wrong name leaves
        may pass for another."""
        squares = {step.cause.key: step.round.scores[step.candidate.key].squares for step in searched.kept}
        largest = max((squares[key] for key in doubted), default=0.0)
        return {key for key, own in squares.items() if own < largest}

    def _without_cause(self, searched: _Searched[CauseT], key: str) -> FittedModel[CauseT]:
        """Return the fit of the final model without one of its accepted causes."""
        others = (step.cause for step in searched.kept if step.cause.key != key)
        return self._fitter.comparable((*self._given, *others), searched.final)

    def _paying(self, searched: _Searched[CauseT]) -> tuple[_Searched[CauseT], list[Verdict[CauseT]]]:
        """Return the search without the accepted causes that do not pay, and all verdicts. Those causes are suspected,
        and the final model does not hold them.

        At its acceptance a cause is compared without those that were accepted later. A cause that fails there is
        compared again, next to all others.
        """
        refuted: list[Verdict[CauseT]] = []
        while True:
            own = {step.cause.key for step in searched.kept}
            verdicts = [
                self._next_to_others(verdict, searched)
                if verdict.cause.key in own and _contradiction(verdict)
                else verdict
                for verdict in self._verdicts(searched, refuted)
            ]
            unpaid = [verdict for verdict in verdicts if verdict.cause.key in own and _unpaid(verdict)]
            if not unpaid:
                return searched, verdicts
            refuted.append(replace(unpaid[-1], verdict=SUSPECTED, reason=_unpaid(unpaid[-1])))
            searched = self._without(searched, unpaid[-1].cause.key)

    def _next_to_others(self, verdict: Verdict[CauseT], searched: _Searched[CauseT]) -> Verdict[CauseT]:
        """Return a verdict with the errors of the final model, and of the final model without the cause."""
        final = searched.final
        without = self._fitter.predicted(self._without_cause(searched, verdict.cause.key))
        held_out = (without.held_out, final.held_out)
        return replace(verdict, before=without.error, after=final.error, floor=final.floor, held_out=held_out)

    def _without(self, searched: _Searched[CauseT], key: str) -> _Searched[CauseT]:
        """Return a search without one of its accepted causes; the others are fitted again in turn."""
        kept: list[_Accepted[CauseT]] = []
        final = searched.plain
        for step in searched.kept:
            if step.cause.key != key:
                causes = (*self._given, *(other.cause for other in kept), step.cause)
                before, final = final, self._fitter.prepared(causes, final)
                kept.append(replace(step, before=before, after=final))
        return replace(searched, kept=kept, final=final)

    def _checked_verdict(
        self,
        verdict: Verdict[CauseT],
        final: FittedModel[CauseT],
        doubt: Reason | None,
        outdone: set[str],
        rivals: Mapping[str, CourseRival],
        weak: set[str],
    ) -> Verdict[CauseT]:
        """Return a verdict after checks on the final model: a found cause that fails one is only suspected.

        Predictions may contradict it. A nonparametric effect (``weak``) is doubted that larger noise than declared may
        have produced. A catalogued cause is also doubted if the final model is inadequate or holds a nonparametric
        effect of which the cause may be a part. So it is if a nonparametric effect was more probable but refused, or
        still explains something next to the cause; if ``rivals`` has random courses against it; or if other causes
        that explain the same are too probable.
        """
        if verdict.verdict != FOUND:
            return verdict
        if reason := _contradiction(verdict):
            return replace(verdict, verdict=SUSPECTED, reason=reason)
        if verdict.cause.key in weak:
            return replace(verdict, verdict=SUSPECTED, reason=Reason.INADEQUATE)
        if not verdict.cause.catalogued or verdict.cause in self._given:
            return verdict
        verdict = replace(verdict, share_explained=share_explained(final, verdict.cause))
        if doubt is not None or verdict.cause.key in outdone:
            course = rivals.get(verdict.cause.key)
            reason = doubt or (Reason.UNNAMED if course is None else Reason.COURSE)
            share = verdict.share_explained if course is None else course.share
            return replace(verdict, verdict=SUSPECTED, reason=reason, course=course, share_explained=share)
        if verdict.probability < _NAMED:
            return replace(verdict, verdict=SUSPECTED, reason=Reason.ALTERNATIVE)
        return verdict

    def _searched_with_scatter(
        self,
        kinds: Sequence[CauseT],
        rounds: list[Round[CauseT]],
        outright: tuple[ScatterCandidate[CauseT], float] | None = None,
    ) -> tuple[_Searched[CauseT], list[FoundScatter[CauseT]]]:
        """Return the search with a wider prior for inputs that scatter, and the scatters found. ``rounds`` holds the
        first round; ``outright`` is a scatter that is accounted for before any cause is searched."""
        scatters: list[FoundScatter[CauseT]] = []
        if outright is not None:
            first = rounds[0].fitted
            doubt = self._noise.doubt_of_inputs(first, outright[0].own, kinds)
            searched, scatter = self._with_input_scatter(*outright, first, kinds, doubt)
            scatters.append(scatter)
        else:
            searched = self._searched(kinds, rounds)
            if searched.kept and self._fitter.readmit(searched.final):
                searched = self._searched(kinds)
        while searched.end.is_complete and len(scatters) < _MOST_SCATTERS:
            more = self._noise.scatter(searched.final, kinds)
            if more is None:
                break
            doubt = self._noise.doubt_of_inputs(self._named_alone(searched), more[0].own, kinds)
            if doubt and self._holds_unnamed(searched, more[0].cause.subject):
                break
            searched, scatter = self._with_input_scatter(*more, searched.plain, kinds, doubt)
            scatters.append(scatter)
        return searched, scatters

    def _named_alone(self, searched: _Searched[CauseT]) -> FittedModel[CauseT]:
        """Return the fit with the accepted causes of the catalogue alone."""
        named = [step.cause for step in searched.kept if step.cause.catalogued]
        return self._fitter.comparable((*self._given, *named), searched.final) if named else searched.plain

    @staticmethod
    def _holds_unnamed(searched: _Searched[CauseT], subject: str) -> bool:
        """Return True if a nonparametric effect of a subject was accepted: it is rough, and what it leaves may pass for
        scatter."""
        return any(not step.cause.catalogued and step.cause.subject == subject for step in searched.kept)

    def _with_input_scatter(
        self,
        candidate: ScatterCandidate[CauseT],
        p_value: float,
        plain: FittedModel[CauseT],
        kinds: Sequence[CauseT],
        doubt: str,
    ) -> tuple[_Searched[CauseT], FoundScatter[CauseT]]:
        """Return a new search with a wider prior for a candidate's inputs, and their scatter, with a ``doubt`` of it.
        All residuals of these inputs in the plain model count as scatter, because causes found before may have absorbed
        some of it; a real cause is found again."""
        candidate = self._fitter.widen(plain, candidate, kinds)
        searched = self._searched(kinds)
        found = self._fitter.input_scatter(searched.final, candidate, p_value)
        doubt = doubt or self._noise.doubt_of_tails(searched.final, candidate.own)
        return searched, replace(found, doubt=doubt)

    def _first_round(self, kinds: Sequence[CauseT]) -> list[Round[CauseT]]:
        """Return a list with the first round. The search goes on in this list, so that nothing else holds the large
        arrays of a round that is over."""
        return [self._round(self._fitter.prepared(self._given), kinds, 0)]

    def _searched(self, kinds: Sequence[CauseT], rounds: list[Round[CauseT]] | None = None) -> _Searched[CauseT]:
        """Return the search from the plain model on; ``rounds`` holds its first round, if known."""
        rounds = rounds or self._first_round(kinds)
        plain = rounds[0].fitted
        found, worse, end = self._forward(rounds, kinds)
        kept, dropped, final = self._dropped(found, plain)
        return _Searched(plain, kept, [*worse, *dropped], rounds, final, end)

    def _verdicts(self, searched: _Searched[CauseT], refuted: Sequence[Verdict[CauseT]] = ()) -> list[Verdict[CauseT]]:
        """Return one verdict per kind of cause, and one per further subject that was found. ``refuted``: verdicts on
        accepted causes that the final model no longer holds."""
        final, held_out = searched.final, self._fitter.held_out
        verdicts = [verdict_on_known_cause(cause, searched.plain, held_out) for cause in self._given]
        for step in searched.kept:
            fits = step.before, step.after
            reported = accepted(step.round, step.candidate, step.cause, fits, final)
            size = step.candidate.signature.parameters
            spread = shape_covariance_factors(self._fitter, final, step.cause, size)
            blocks = self._fitter.blocks
            gain = gain_in_blocks(final, step.cause, size, blocks or ())
            covariance, probability = reported.covariance * spread, step.probability
            reported = replace(reported, covariance=covariance, probability=probability, subjects=step.chosen.subjects)
            verdicts.append(replace(reported, blocks_asked=blocks is not None, block_gain=gain))
        verdicts += refuted
        others = [*self._rivals(searched.kept), *searched.refused, *self._rejected(searched.rounds, searched.end)]
        for verdict in others:  # one row per kind of cause: its first verdict
            if verdict.cause.id not in {reported.cause.id for reported in verdicts}:
                verdicts.append(verdict)
        return verdicts

    def _round(self, fitted: FittedModel[CauseT], kinds: Sequence[CauseT], number: int) -> Round[CauseT]:
        self._progress(f"scoring the candidates of {len(kinds)} kinds of cause")
        return score_round(fitted, kinds, self._settings.draws, np.random.default_rng([self._settings.seed, number]))

    def _forward(
        self, rounds: list[Round[CauseT]], kinds: Sequence[CauseT]
    ) -> tuple[list[_Accepted[CauseT]], list[Verdict[CauseT]], EndOfSearch[CauseT]]:
        """Return the causes accepted in turn, those refused because they predict worse, and the end of the search; adds
        rounds."""
        found: list[_Accepted[CauseT]] = []
        worse: list[Verdict[CauseT]] = []
        pairs, further = True, FurtherCauses[CauseT]()
        while True:
            current, known_worse = rounds[-1], {verdict.cause.id for verdict in worse}
            refused = known_worse | further.unpaid
            chosen = choose(current, refused, self._settings.level, pairs=pairs)
            limit = further.limit([step.cause for step in found], current.fitted)
            if limit is not None or chosen is None:
                left = chosen or choose(current, known_worse, self._settings.level, pairs=pairs)
                cause_left = None if left is None else left.candidate.cause
                return found, worse, further.end(limit, len(found), current, cause_left)
            chosen, cause, after = self._fitted(chosen, current)
            covered = self._covered(cause, after)
            if len(found) >= search_end.MANY_CAUSES and not further.pays(current.fitted, after, covered):
                further.unpaid.add(chosen.candidate.kind)
                continue
            if predicts_worse(current.fitted.held_out, after.held_out, covered):
                worse.append(first_order(current, chosen.candidate, REJECTED, self._fitter.held_out, Reason.HELD_OUT))
                continue
            outdone, choice = is_outdone(current, chosen.candidate, refused), current.choice(chosen.candidate)
            if not chosen.of_two:  # accepted: two rounds at once need twice the memory
                current, chosen = self._closed(rounds), chosen.light()
            next_round = self._round(after, kinds, len(rounds))
            pairs = not chosen.of_two or confirmed(current, chosen, next_round, self._settings.level, refused)
            if not pairs:
                continue
            closed = self._closed(rounds)
            probability = chosen.probability
            if not chosen.of_two:
                probability = closed.probability_of_name(chosen.candidate, next_round)
            found.append(_Accepted(chosen.light(), closed, cause, closed.fitted, after, outdone, choice, probability))
            rounds.append(next_round)

    @staticmethod
    def _closed(rounds: list[Round[CauseT]]) -> Round[CauseT]:
        """Close the last round and release its fit; return the closed round."""
        if rounds[-1].search is not None:
            rounds[-1] = rounds[-1].closed()
            rounds[-1].fitted.release()
        return rounds[-1]

    def _fitted(
        self, chosen: CandidateChoice[CauseT], current: Round[CauseT]
    ) -> tuple[CandidateChoice[CauseT], CauseT, FittedModel[CauseT]]:
        """Return the choice, its cause in the form that is fitted, and the model with it, without parts that have no
        effect."""
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
        """Return True for held-out epochs (B,) at which a cause claims to hold."""
        held = self._fitter.held_out
        if held is None:
            return np.ones(len(after.measured.seen), bool)
        return np.asarray(cause.covers(held.conditions.covariates, len(held.measured.seen)))

    def _dropped(
        self, found: list[_Accepted[CauseT]], plain: FittedModel[CauseT]
    ) -> tuple[list[_Accepted[CauseT]], list[Verdict[CauseT]], FittedModel[CauseT]]:
        """Return the accepted causes that are still needed, verdicts on the dropped ones, and the final model."""
        final, kept = found[-1].after if found else plain, list(found)
        dropped: list[Verdict[CauseT]] = []
        for step in found[:-1]:
            if len(kept) > 1 and not self._is_needed(step, final, [other.cause for other in kept if other is not step]):
                kept.remove(step)
                dropped.append(first_order(step.round, step.candidate, REJECTED, self._fitter.held_out, Reason.DROPPED))
                final = self._fitter.prepared((*self._given, *(other.cause for other in kept)), final)
        return kept, dropped, final

    def _is_needed(self, step: _Accepted[CauseT], final: FittedModel[CauseT], others: Sequence[CauseT]) -> bool:
        """Return True if an accepted cause is still significant in the final model, at the search's threshold. By
        Wald's test or, if the cause has shape parameters, by a fit without it: a poorly determined shape widens the
        uncertainty of amplitudes."""
        values, covariance = final.values(step.cause)
        size = step.candidate.signature.parameters
        null = step.round.null
        group = null.group_of(step.candidate.kind, step.candidate.signature.rank)
        limit = null.threshold(group, self._settings.level)
        squares = float(values[:size] @ np.linalg.solve(covariance[:size, :size], values[:size]))
        if null.raw(squares, group, 1.0) <= limit:
            return True
        if step.cause.key == step.candidate.key:  # no shape parameters
            return False
        without = self._fitter.comparable((*self._given, *others), final)
        gained = float(np.sum(without.fit.whitened.rest**2) - np.sum(final.fit.whitened.rest**2))
        return bool(null.raw(gained / final.noise_ratio**2, group, 1.0) <= limit)

    def _rivals(self, kept: Sequence[_Accepted[CauseT]]) -> list[Verdict[CauseT]]:
        """Return verdicts on other kinds that explain a finding as well, so that the campaign cannot
        distinguish them."""
        found, held_out = [], self._fitter.held_out
        for step in kept:
            for rival, lead in step.chosen.rivals:
                worth = is_worth_reporting(rival, lead) or step.probability < _NAMED
                if rival.kind != step.candidate.kind and worth:
                    own = self._fitter.fitted((*step.round.fitted.causes, rival.cause.refined()), step.round.fitted)
                    plain = first_order(step.round, rival, INDISTINGUISHABLE, held_out, Reason.RIVAL)
                    odds = step.round.posterior(step.candidate) + lead
                    found.append(replace(plain, own=own, log_odds=odds, rival=step.cause))
        return found

    def _rejected(self, rounds: Sequence[Round[CauseT]], end: EndOfSearch[CauseT]) -> list[Verdict[CauseT]]:
        """Return the verdicts on the best candidate of every kind that the final model does not hold. Their log odds
        are those of the first round, where they competed with the causes found."""
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


def of_larger_noise(
    steps: Mapping[str, _Accepted[CauseT]], verdicts: Sequence[Verdict[CauseT]], ratio: float, level: float
) -> set[str]:
    """Return the keys of effects that are not significant at ``ratio`` times the declared noise.

    ``steps``: accepted effects by key. The search rescales the noise within limits only; beyond them, scatter of whole
    epochs looks like an effect of many amplitudes.
    """
    weak = set()
    for verdict in verdicts:
        if (step := steps.get(verdict.cause.key)) is None:
            continue
        null = step.round.null
        group = null.group_of(step.candidate.kind, step.candidate.signature.rank)
        squares = (verdict.signal_to_noise / max(ratio, 1.0)) ** 2
        if null.raw(squares, group, 1.0) > null.threshold(group, level):
            weak.add(verdict.cause.key)
    return weak


def _contradiction(verdict: Verdict[CauseT]) -> Reason | None:
    """Return the reason why predictions contradict a found cause, None where they do not: it does not pay, or blocks
    left out are less probable with the cause (``ELSEWHERE``)."""
    is_elsewhere_worse = verdict.block_gain is not None and verdict.block_gain.log_gain < -np.log(RIVAL_FACTOR)
    return _unpaid(verdict) or (Reason.ELSEWHERE if is_elsewhere_worse else None)


def _unpaid(verdict: Verdict[CauseT]) -> Reason | None:
    """Return the reason why a found cause does not pay, None where it does: predictions do not improve (``UNPAID``), or
    held-out epochs are predicted worse (``HELD_OUT``), and not by chance."""
    before, after = verdict.held_out
    held_out, is_chance = 1.0, True
    if before is not None and after is not None:
        held_out = after.growth_over(before)
        is_chance = after.log_odds_over(before) > -np.log(RIVAL_FACTOR)
    pays = verdict.signal_to_noise > 0.0 and verdict.after.growth_over(verdict.before) <= _NO_MORE
    if not pays and held_out > 1.0 / _NO_WORSE:  # an effect in held-out epochs alone lowers only their errors
        return Reason.UNPAID
    return Reason.HELD_OUT if held_out > _NO_WORSE and not is_chance else None
