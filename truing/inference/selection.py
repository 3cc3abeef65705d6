"""Diagnosis of one campaign: forward selection of causes, next to noise and scatter that depend on something.

An accepted candidate is significant in the search over all candidates. It is the most probable one by evidence, in
pairs where two explain what a third would absorb. It does not predict held-out epochs worse; after many causes, it
predicts them better. At the end each accepted cause is dropped if the others explain its effect. If the noise depends
on something, observations are weighted accordingly and the search is repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic

import numpy as np

from truing.inference.adequacy import Adequacy, MisfitKind, adequacy_of
from truing.inference.attribution import Attributed, Attributions, attributed
from truing.inference.blocks import EpochBlocks
from truing.inference.doubts import Doubts, of_larger_noise, outdone_causes
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter, ScreenedValue
from truing.inference.forward_search import ForwardSearch, Settings
from truing.inference.model import CampaignModel, CauseT, ConditionsLike, ConditionsT, ScatterCandidate
from truing.inference.noise import NoiseDependence, NoiseLevel, noise_level
from truing.inference.noise_selection import NoiseSelection
from truing.inference.observations import Epochs
from truing.inference.prediction import is_beyond_floor
from truing.inference.rounds import Round
from truing.inference.scatter import FoundScatter
from truing.inference.search import Search
from truing.inference.search_end import EndOfSearch
from truing.inference.search_result import Searched, contested_causes
from truing.inference.search_verdicts import SearchVerdicts
from truing.inference.single_errors import SingleErrors, single_errors
from truing.inference.verdicts import FOUND, SUSPECTED, Reason, Verdict
from truing.inference.without_causes import Errors, errors_without

__all__ = ("CauseDiagnosis", "CauseSelection", "Settings")

_MOST_DEPENDENCES = 2
_MOST_SCATTERS = 2
_SEVERAL_PERIODS = 2
_LEVEL_OF_COURSE = 0.05  # of a model that does not hold: odds of 20 to 1 that a course follows an input
_OF_NAMES = (Reason.ALTERNATIVE, Reason.ASSUMED, Reason.WEAK)  # doubts of a name, and not of the model
_ADEQUACY = 8  # stream of random numbers


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
    single_errors: SingleErrors[CauseT] | None = None  # of one input, which has heavy tails
    has_repeats: bool = True  # whether inputs were repeated, so that scatter differs from an effect of fine pattern

    @property
    def floor_has_scatter(self) -> bool:
        """True if the noise floor holds scatter that was found next to the declared noise."""
        return bool(self.scatters or self.noise_dependences)

    @cached_property
    def errors_without_any(self) -> Errors[CauseT]:
        """Errors of the plain model on fitted and on held-out epochs, without causes known before the search either."""
        if not self.plain.causes:
            return self.plain.error, self.plain.held_out
        return errors_without(self.plain, self.plain.causes, self.held_out)


@dataclass(frozen=True)
class _Accounted(Generic[CauseT]):
    """A search, next to the noise and the scatter that were accounted for before it."""

    searched: Searched[CauseT]
    noise_dependences: Sequence[NoiseDependence]
    scatters: Sequence[FoundScatter[CauseT]]

    @property
    def has_names(self) -> bool:
        """True if the search accepted a cause of the catalogue, which may have absorbed a part of an unknown effect."""
        return any(step.cause.catalogued for step in self.searched.kept)

    def is_named(self, larger: Sequence[NoiseDependence]) -> bool:
        """Return False if the final model holds something without a name, of which any catalogued cause may be a part.

        That is a nonparametric effect, or noise that may be one.
        """
        return self.is_random(larger) and all(cause.catalogued for cause in self.searched.final.causes)

    def is_random(self, larger: Sequence[NoiseDependence]) -> bool:
        """Return False if noise ``larger`` than declared may be an unknown effect.

        It is larger in several periods, or in one while inputs scatter. Or it is not random.
        """
        periods = sum(entry.driver.cause is not None for entry in larger)
        few = periods < (1 if self.scatters else _SEVERAL_PERIODS)
        doubted = any(entry.doubt for entry in larger) or any(entry.doubt for entry in self.scatters)
        return few and not doubted


@dataclass(frozen=True)
class _Left:
    """Residuals of the final model: its noise, single channels with larger noise, and tests of it as a whole."""

    noise: NoiseLevel
    noisy: tuple[tuple[int, NoiseLevel], ...]
    adequacy: Adequacy
    larger: tuple[NoiseDependence, ...]  # dependences by which some noise is larger than declared
    is_noisier: bool  # larger noise than declared, as a whole or in places, which no cause of noise explains
    holds: bool  # complete, adequate, and without larger noise


class CauseSelection(Generic[CauseT]):
    """Search over a catalogue of causes for one campaign; ``run`` returns every verdict and the final model.

    ``given`` are causes known before any search, such as exchanged labels; every model of the search holds them.
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
        fitter: Fitter[CauseT] = Fitter(model, calibration, held_out, settings.seed, progress)
        self._search = ForwardSearch(fitter, settings, tuple(given), progress)
        self._noise = NoiseSelection(fitter, settings.level, settings.noise_level, settings.dependence_level)

    def run(self, kinds: Sequence[CauseT]) -> CauseDiagnosis[CauseT]:
        """Return the diagnosis over all kinds of cause of a catalogue."""
        accounted = self._accounted(kinds)
        searched, verdicts = SearchVerdicts(self._search).paying(accounted.searched, kinds)
        accounted = replace(accounted, searched=searched)
        left = self._left(accounted)
        holds, is_named = left.holds, accounted.is_named(left.larger)
        outdone, courses = outdone_causes(self._search, searched, verdicts, compares_courses=holds and is_named)
        # Where no name was accepted, the effects without a name leave nothing, and have inputs of their own.
        is_clear = holds and (is_named or (accounted.is_random(left.larger) and not accounted.has_names))
        is_clear &= not outdone and all(verdict.verdict != SUSPECTED for verdict in verdicts)
        attribution = (
            Attributions()
            if is_clear and searched.kept
            else self._attributed(
                accounted, outdone if is_named else {step.cause.key for step in searched.kept}, holds=holds
            )
        )
        attributions = attribution.found
        # What inputs predict is no scatter, though it may pass for one.
        is_named &= bool(searched.kept) or not attributions
        doubt = Reason.INADEQUATE if not holds else None if is_named else Reason.UNNAMED
        steps = {step.cause.key: step for step in searched.kept if not step.cause.catalogued}
        ratio, level = left.noise.ratio, self._search.settings.level
        weak = of_larger_noise(steps, verdicts, ratio, level) if left.is_noisier else set()
        with_rivals = {verdict.rival.key for verdict in verdicts if verdict.rival is not None}
        doubts = Doubts(doubt, outdone, courses, weak, with_rivals, contested_causes(searched.kept))
        verdicts = [doubts.checked(verdict, searched.final, searched.given) for verdict in verdicts]
        if not holds:
            verdicts = [_with_confirmed_inputs(verdict, searched.final, attributions) for verdict in verdicts]
        return self._diagnosis(kinds, accounted, left, verdicts, doubt, attribution)

    def _accounted(self, kinds: Sequence[CauseT]) -> _Accounted[CauseT]:
        """Return the search after noise that depends on something, and inputs that scatter, are accounted for."""
        search, noise = self._search, self._noise
        rounds = search.first_round(kinds)
        scatter = noise.scatter(rounds[0].fitted, kinds)
        outright = None if scatter is None else noise.outright_scatter(rounds[0], scatter)
        # Scatter of inputs could explain the larger residuals of some time.
        noise_dependences = noise.noisy_periods(rounds[0], kinds) if scatter is None else []
        if noise_dependences:
            rounds = search.first_round(kinds)
        searched, scatters = self._searched_with_scatter(kinds, rounds, outright)
        before = len(noise_dependences)
        # A search that reached a limit leaves more than noise, so its residuals cannot show on what the noise depends.
        while searched.end.is_complete and (
            more_dependences := noise.dependences(searched.final, kinds, _MOST_DEPENDENCES - len(noise_dependences))
        ):
            noise_dependences += more_dependences
            searched = search.searched(kinds)
        later = noise_dependences[before:]
        if (
            scatters
            and later
            and (outright is None or any(dependence.driver.cause is not None for dependence in later))
        ):
            search.fitter.narrow()  # noisier observations explain the apparent scatter of inputs
            searched, scatters = self._searched_with_scatter(kinds, search.first_round(kinds))
        return _Accounted(searched, noise_dependences, scatters)

    def _left(self, accounted: _Accounted[CauseT]) -> _Left:
        """Return the remainder that the final model of a search leaves."""
        final, fitter, settings = accounted.searched.final, self._search.fitter, self._search.settings
        noise = noise_level(final.fit.whitened, final.measured, fitter.declared)
        adequacy = adequacy_of(final, noise, np.random.default_rng([settings.seed, _ADEQUACY]), fitter.repeats)
        noisy = tuple(self._noise.noisy_channels(final))
        larger = tuple(self._larger_than_declared(accounted.noise_dependences, final))
        is_noisier = bool(noisy) or noise.p_value <= settings.noise_level
        is_noisier |= any(dependence.driver.cause is None for dependence in larger)
        holds = accounted.searched.end.is_complete and adequacy.p_value > settings.doubted_level and not is_noisier
        holds = holds and not is_beyond_floor(final.error, final.floor)
        return _Left(noise, noisy, adequacy, larger, is_noisier, holds)

    def _larger_than_declared(
        self, dependences: Sequence[NoiseDependence], final: FittedModel[CauseT]
    ) -> Iterator[NoiseDependence]:
        """Yield the dependences by which some noise is larger than declared: an effect without a name may be in it.

        Others may scatter as declared where the noise is largest. Observations were weighted by all of them, so the
        declared noise is without these weights."""
        declared = self._search.fitter.declared
        for dependence in dependences:
            declared = declared / dependence.factor[..., None, None] ** 2
        for dependence in dependences:
            level = noise_level(final.fit.whitened, final.measured, declared, dependence.factor > 1.0)
            if level.p_value <= self._search.settings.noise_level:
                yield dependence

    def _diagnosis(
        self,
        kinds: Sequence[CauseT],
        accounted: _Accounted[CauseT],
        left: _Left,
        verdicts: Sequence[Verdict[CauseT]],
        doubt: Reason | None,
        attribution: Attributions,
    ) -> CauseDiagnosis[CauseT]:
        """Return the diagnosis with the verdicts and a doubt of the whole model."""
        searched, fitter = accounted.searched, self._search.fitter
        # Where only the name is open the model is right all the same.
        is_sure = doubt is None and all(v.verdict != SUSPECTED or v.reason in _OF_NAMES for v in verdicts)
        doubted = "" if is_sure else doubt or Reason.UNNAMED  # residuals of a doubtful model hold more than noise
        return CauseDiagnosis(
            tuple(sorted(verdicts, key=lambda verdict: verdict.rank)),
            searched.plain,
            searched.final,
            tuple(searched.rounds),
            searched.search,
            tuple(fitter.screened),
            left.noise,
            left.noisy,
            tuple(replace(dependence, doubt=doubted or dependence.doubt) for dependence in accounted.noise_dependences),
            replace(left.adequacy, too_large=frozenset({MisfitKind.PARTS} if attribution.ended_early else ())),
            searched.end,
            tuple(replace(scatter, doubt=doubted or scatter.doubt) for scatter in accounted.scatters),
            fitter.held_out,
            self._untestable_kinds(kinds, searched),
            tuple(fitter.blocks or ()),
            attribution.found,
            self._single_errors(kinds, searched),
            fitter.repeats is not None,
        )

    def _single_errors(self, kinds: Sequence[CauseT], searched: Searched[CauseT]) -> SingleErrors[CauseT] | None:
        """Return the single errors of one input of a complete search, whose subject has no other effect."""
        final = searched.final
        if not searched.end.is_complete:
            return None
        subjects = {cause.subject for cause in final.causes}
        inputs = [single_error for kind in kinds for single_error in final.scene.single_errors(kind)]
        single_error_found = single_errors(final, inputs, self._search.fitter.input_factor)
        return (
            None
            if single_error_found is None or single_error_found.candidate.cause.subject in subjects
            else single_error_found
        )

    def _untestable_kinds(self, kinds: Sequence[CauseT], searched: Searched[CauseT]) -> tuple[CauseT, ...]:
        """Return the kinds of cause without any candidate in this campaign, neither of an effect nor of scatter."""
        known = {*searched.rounds[0].best, *(cause.id for cause in self._search.given)}
        scene = searched.plain.scene
        return tuple(kind for kind in kinds if kind.id not in known and not scene.scatters(kind))

    def _attributed(self, accounted: _Accounted[CauseT], outdone: Collection[str], *, holds: bool) -> Attributions:
        """Return the inputs that predict residuals of the plain model with the causes that are not ``outdone`` (keys).

        A model with wrong causes may have absorbed a dependence. If the final model does not hold, the campaign is
        known to hold something else, and a larger level suffices. Its own residuals are also tested: what it explains
        no longer hides the rest. Residuals are without a burst of noise that is only suspected: it may be an effect.
        """
        self._search.progress("what the misfit follows")
        searched, settings = accounted.searched, self._search.settings
        bursts = [
            dependence.factor
            for dependence in accounted.noise_dependences
            if dependence.driver.cause and (dependence.doubt or not holds)
        ]
        doubted = np.prod(bursts, axis=0) if bursts else None
        plain, level = searched.plain, settings.dependence_level
        if holds:
            certain = [step.cause for step in searched.kept if step.cause.key not in outdone]
            causes = (*searched.given, *certain)
            model = self._search.fitter.comparable(causes, searched.final) if certain else plain
            found_without = attributed(plain, (model,), level, level, doubted).found
            remains = len(certain) == len(searched.kept)  # the final model holds: its causes leave nothing
            return Attributions(tuple(replace(attribution, remains=remains) for attribution in found_without))
        # A drift that is accounted for in part leaves residuals that no function of time alone explains.
        final = self._search.without_drifts(searched)
        models = (plain,) if final is plain else (plain, final)
        return attributed(plain, models, settings.doubted_level, _LEVEL_OF_COURSE, doubted)

    def _searched_with_scatter(
        self,
        kinds: Sequence[CauseT],
        rounds: list[Round[CauseT]],
        outright: tuple[ScatterCandidate[CauseT], float] | None = None,
    ) -> tuple[Searched[CauseT], list[FoundScatter[CauseT]]]:
        """Return the search with a wider prior for inputs that scatter, and the scatters found. ``rounds`` holds the
        first round; ``outright`` is a scatter that is accounted for before any cause is searched."""
        scatters: list[FoundScatter[CauseT]] = []
        if outright is not None:
            first = rounds[0].fitted
            doubt = self._noise.doubt_of_inputs(first, outright[0].own, kinds)
            searched, scatter = self._with_input_scatter(*outright, first, kinds, doubt)
            if scatter.remains:
                scatters.append(scatter)
            else:  # an effect that was found next to it looked like scatter
                self._search.fitter.narrow()
                rounds = self._search.first_round(kinds)
        if not scatters:
            searched = self._search.searched(kinds, rounds)
            # A model that leaves more than noise cannot tell an effect from a gross error.
            if searched.kept and searched.end.is_complete and self._search.fitter.readmit(searched.final):
                searched = self._search.searched(kinds)
        while searched.end.is_complete and len(scatters) < _MOST_SCATTERS:
            more = self._noise.scatter(searched.final, kinds)
            if more is None:
                break
            doubt = self._noise.doubt_of_inputs(self._search.named_alone(searched), more[0].own, kinds)
            if doubt and self._holds_unnamed(searched, more[0].cause.subject):
                break
            before = self._search.fitter.input_factor
            wider, scatter = self._with_input_scatter(*more, searched.plain, kinds, doubt)
            if not scatter.remains:
                self._search.fitter.narrow(before)
                return self._search.searched(kinds), scatters
            searched = wider
            scatters.append(scatter)
        return searched, scatters

    @staticmethod
    def _holds_unnamed(searched: Searched[CauseT], subject: str) -> bool:
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
    ) -> tuple[Searched[CauseT], FoundScatter[CauseT]]:
        """Return a new search with a wider prior for a candidate's inputs, and their scatter, with a ``doubt`` of it.
        All residuals of these inputs in the plain model count as scatter, because causes found before may have absorbed
        some of it; a real cause is found again. Where the inputs scatter less next to the causes found, the search is
        repeated with that scatter: a prior too wide hides other causes and raises the noise floor."""
        fitter = self._search.fitter
        candidate = fitter.widen(plain, candidate, kinds)
        searched = self._search.searched(kinds)
        input_scatter = fitter.input_scatter(searched.final, candidate, p_value)
        if input_scatter.remains and fitter.narrow_to(searched.final, candidate):
            searched = self._search.searched(kinds)
            input_scatter = fitter.input_scatter(searched.final, candidate, p_value)
        doubt = doubt or self._noise.doubt_of_tails(searched.final, candidate.own)
        return searched, replace(input_scatter, doubt=doubt)


def _with_confirmed_inputs(
    verdict: Verdict[CauseT], final: FittedModel[CauseT], attributions: Sequence[Attributed]
) -> Verdict[CauseT]:
    """Return the verdict, only suspected if it is on a nonparametric effect of a model that does not hold, and errors
    do not confirm it: of forms that are all wrong, the best one need have neither the right inputs nor the right part.

    Residuals as such, or errors of its part, must depend on its inputs; and not only errors of another part on just
    these. An effect of all parts, with an input of each, needs most of them.
    """
    if verdict.verdict != FOUND or verdict.cause.catalogued:
        return verdict
    subject, parts = f" {verdict.cause.subject} ", final.model.part_count
    has_part = bool(verdict.cause.subject)
    inputs = set(verdict.cause.inputs(parts))
    of_part = [
        attribution for attribution in attributions if attribution.subject and f" {attribution.subject} " in subject
    ]
    of_others = [attribution for attribution in attributions if attribution.subject and attribution not in of_part]
    of_this_scatter = [attribution for attribution in attributions if attribution not in of_others or not has_part]
    left = inputs - {name for attribution in of_this_scatter for name in attribution.inputs}
    is_elsewhere = any(inputs == set(attribution.inputs) for attribution in of_others) and not of_part
    is_confirmed = not (left or is_elsewhere) if has_part else not left or len(inputs) == parts > 2 * len(left)
    return verdict if is_confirmed else replace(verdict, verdict=SUSPECTED, reason=Reason.INADEQUATE)
