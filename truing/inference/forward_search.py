"""Search for causes from the plain model on: accept the most probable one, refit everything, repeat.

Each accepted cause, and each that was known before, is dropped at the end if the others explain its effect.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from truing.inference import search_end
from truing.inference.accepted_cause import Accepted
from truing.inference.arrays import Mask
from truing.inference.cause_forms import CauseForms, fitted_in_turn
from truing.inference.choice import CandidateChoice, choose, chosen_again, confirmed, is_outdone, is_real
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.inference.model import CauseT
from truing.inference.onset_search import onset_interval
from truing.inference.other_shapes import OtherShape, other_shape
from truing.inference.prediction import predicts_worse
from truing.inference.rounds import RIVAL_FACTOR, Round, score_round
from truing.inference.search import CauseCandidate
from truing.inference.search_end import EndOfSearch, FurtherCauses, SearchEnd
from truing.inference.search_result import Searched, names_of_one_effect
from truing.inference.verdicts import REJECTED, Reason, Verdict, first_order, verdict_on_known_cause

# Shares of the declared false-alarm rate: search for causes, noise larger than declared, noise that depends on
# something, and doubt of the whole model.
_CAUSES, _NOISE, _DEPENDENCE, _DOUBTED = 0.45, 0.05, 0.1, 0.4
# Most catalogued causes that are tried together in place of a nonparametric effect. A nonparametric effect may imitate
# more of them, but so many would imitate it.
_MOST_TOGETHER = 4


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
class ForwardSearch(Generic[CauseT]):
    """Forward search on the fits of a ``Fitter``, in which every model holds the ``given`` causes, known before."""

    fitter: Fitter[CauseT]
    settings: Settings
    given: tuple[CauseT, ...]
    progress: Callable[[str], None]

    @property
    def forms(self) -> CauseForms[CauseT]:
        """Comparison of the forms of a cause."""
        return CauseForms(self.fitter, self.given)

    def first_round(self, kinds: Sequence[CauseT]) -> list[Round[CauseT]]:
        """Return a list with the first round. The search goes on in this list, so that nothing else holds the large
        arrays of a round that is over."""
        return [self.scored(self.fitter.prepared(self.given), kinds, 0)]

    def searched(self, kinds: Sequence[CauseT], rounds: list[Round[CauseT]] | None = None) -> Searched[CauseT]:
        """Return the search from the plain model on; ``rounds`` holds its first round, if known."""
        rounds = rounds or self.first_round(kinds)
        return self._completed(rounds, kinds, rounds[0].fitted, [], [])

    def continued(
        self, searched: Searched[CauseT], kinds: Sequence[CauseT], steps: Sequence[Accepted[CauseT]]
    ) -> Searched[CauseT]:
        """Return a search that goes on after other accepted causes than its own, in the order of ``steps``."""
        search, rounds = replace(self, given=searched.given), list(searched.rounds)
        refitted = search._refitted(searched, steps)
        self._closed(rounds)
        rounds[-1] = search.scored(refitted.final, kinds, len(rounds))
        worse = [verdict for verdict in searched.refused if verdict.reason is Reason.HELD_OUT]
        goes_on = search._completed(rounds, kinds, searched.plain, refitted.kept, worse)
        others = [verdict for verdict in searched.refused if verdict.reason is not Reason.HELD_OUT]
        return replace(goes_on, refused=[*others, *goes_on.refused])

    def _completed(
        self,
        rounds: list[Round[CauseT]],
        kinds: Sequence[CauseT],
        plain: FittedModel[CauseT],
        found: list[Accepted[CauseT]],
        worse: list[Verdict[CauseT]],
    ) -> Searched[CauseT]:
        """Return the search after ``found`` causes and verdicts on those that predict ``worse``; adds to all lists."""
        end = self._forward(rounds, kinds, found, worse)
        kept, dropped, final = self._dropped(found, plain)
        searched = Searched(self.given, plain, kept, [*worse, *dropped], rounds, final, end)
        searched = self._refitted(searched, kept) if dropped else searched
        return self._without_needless(self._plain_again(searched))

    def _plain_again(self, searched: Searched[CauseT]) -> Searched[CauseT]:
        """Return a search in which causes that are no longer distinct from their plain form, next to all others, have
        that form."""
        steps = [self._plain_step(step, searched.final) for step in searched.kept]
        return (
            searched
            if all(new is old for new, old in zip(steps, searched.kept, strict=True))
            else self._refitted(searched, steps)
        )

    @staticmethod
    def _plain_step(step: Accepted[CauseT], final: FittedModel[CauseT]) -> Accepted[CauseT]:
        if not step.cause.plain_id or step.cause.is_distinct(*final.values(step.cause)):
            return step
        wanted = (step.cause.plain_id, step.cause.subject)
        plain = next((c for c in step.round.candidates if (c.cause.id, c.cause.subject) == wanted), None)
        if plain is None:
            return step
        return replace(step, chosen=replace(step.chosen, candidate=plain), cause=plain.cause.refined())

    def _without_needless(self, searched: Searched[CauseT]) -> Searched[CauseT]:
        """Return a search without the known causes whose size is not significant next to the accepted ones, the least
        significant first."""
        held_out = self.fitter.held_out
        while searched.given:
            verdicts = [
                verdict_on_known_cause(cause, searched.plain, searched.final, held_out) for cause in searched.given
            ]
            last = max(verdicts, key=lambda verdict: verdict.p_value)
            if last.p_value <= self.settings.level:
                break
            given = tuple(cause for cause in searched.given if cause is not last.cause)
            refused = [*searched.refused, replace(last, verdict=REJECTED, reason=Reason.DROPPED, probability=0.0)]
            plain = self.fitter.prepared(given, searched.plain)
            searched = self._refitted(replace(searched, given=given, plain=plain, refused=refused), searched.kept)
        return searched

    def without(self, searched: Searched[CauseT], key: str) -> Searched[CauseT]:
        """Return a search without one of its accepted causes; the others are fitted again in turn."""
        return self._refitted(searched, [step for step in searched.kept if step.cause.key != key])

    def _refitted(self, searched: Searched[CauseT], steps: Sequence[Accepted[CauseT]]) -> Searched[CauseT]:
        """Return a search with some of its accepted causes, which are fitted again in turn."""
        kept = fitted_in_turn(self.fitter, searched.given, steps, searched.plain)
        return replace(searched, kept=kept, final=kept[-1].after if kept else searched.plain)

    def without_cause(self, searched: Searched[CauseT], key: str) -> FittedModel[CauseT]:
        """Return the fit of the final model without one of its accepted causes."""
        return self.without_causes(searched, {key})

    def without_causes(self, searched: Searched[CauseT], keys: Collection[str]) -> FittedModel[CauseT]:
        """Return the fit of the final model without some of its accepted causes."""
        others = (step.cause for step in searched.kept if step.cause.key not in keys)
        return self.fitter.comparable((*searched.given, *others), searched.final)

    def without_drifts(self, searched: Searched[CauseT]) -> FittedModel[CauseT]:
        """Return the final fit without the accepted nonparametric effects that end with the campaign."""
        kept = [step.cause for step in searched.kept if step.cause.catalogued or step.cause.is_persistent]
        if len(kept) == len(searched.kept):
            return searched.final
        return self.fitter.comparable((*searched.given, *kept), searched.final) if kept else searched.plain

    def named_alone(self, searched: Searched[CauseT]) -> FittedModel[CauseT]:
        """Return the fit with the accepted causes of the catalogue alone."""
        named = searched.named()
        return self.fitter.comparable((*searched.given, *named), searched.final) if named else searched.plain

    def scored(self, fitted: FittedModel[CauseT], kinds: Sequence[CauseT], number: int) -> Round[CauseT]:
        """Return the round of candidates next to a fitted model; ``number`` of the round, for its random draws."""
        self.progress(f"scoring the candidates of {len(kinds)} kinds of cause")
        return score_round(fitted, kinds, self.settings.draws, np.random.default_rng([self.settings.seed, number]))

    def _forward(
        self,
        rounds: list[Round[CauseT]],
        kinds: Sequence[CauseT],
        found: list[Accepted[CauseT]],
        worse: list[Verdict[CauseT]],
    ) -> EndOfSearch[CauseT]:
        """Return the end of the search; adds rounds, causes accepted in turn, and verdicts on those that predict
        worse."""
        pairs, further, together, asked_shapes = True, FurtherCauses[CauseT](), True, set[str]()
        while True:
            current, known_worse = rounds[-1], {verdict.cause.id for verdict in worse}
            refused = known_worse | further.unpaid
            chosen = choose(current, refused, self.settings.level, pairs=pairs)
            next_cause = None if chosen is None else chosen.candidate.cause
            limit = further.limit([step.cause for step in found], current.fitted, next_cause)
            if chosen is None and self._is_restated(found, rounds, kinds, None):
                continue
            is_unnamed = chosen is None or not chosen.candidate.cause.catalogued
            if is_unnamed and self._has_other_shape(found, rounds, kinds, asked_shapes):
                continue
            if limit is not None or chosen is None:
                left = chosen or choose(current, known_worse, self.settings.level, pairs=pairs)
                if left is None and known_worse:
                    left = choose(current, set(), self.settings.level, pairs=pairs)
                    limit = limit if left is None else SearchEnd.REFUSED
                cause_left = None if left is None else left.candidate.cause
                return further.end(limit, len(found), current, cause_left)
            if together and not chosen.candidate.cause.catalogued:
                together = False
                if by_names := self._together(rounds, kinds, refused, chosen.candidate):
                    found += by_names
                    return further.end(None, len(found), rounds[-1], None)
            asked = chosen.candidate  # a plainer one may take its place; if that fails, this one is refused
            chosen, cause, after = self.fitted_form(chosen, current)
            if self._is_restated(found, rounds, kinds, after):
                continue
            covered = self.covered(cause, after)
            if len(found) >= search_end.MANY_CAUSES and not further.pays(current.fitted, after, covered):
                further.unpaid.add(asked.kind)
                continue
            if predicts_worse(current.fitted.held_out, after.held_out, covered):
                worse.append(first_order(current, asked, REJECTED, self.fitter.held_out, Reason.HELD_OUT))
                continue
            accepted = self.accepted(chosen, cause, current, after, refused)
            if not chosen.of_two:  # two rounds at once need twice the memory
                accepted = accepted.light(self._closed(rounds))
                current, chosen = accepted.round, accepted.chosen
            next_round = self.scored(after, kinds, len(rounds))
            pairs = not chosen.of_two or confirmed(current, chosen, next_round, self.settings.level, refused)
            if not pairs:
                continue
            accepted = accepted.light(self._closed(rounds))
            if not chosen.of_two:
                probability = accepted.round.probability_of_name(accepted.candidate, next_round)
                accepted = replace(accepted, probability=probability)
            found.append(accepted)
            rounds.append(next_round)

    def accepted(
        self,
        chosen: CandidateChoice[CauseT],
        cause: CauseT,
        current: Round[CauseT],
        after: FittedModel[CauseT],
        refused: Collection[str] = (),
    ) -> Accepted[CauseT]:
        """Return a choice of an open round as accepted, in the form that was fitted, with the model after it."""
        candidate = chosen.candidate
        return Accepted(
            chosen,
            current,
            cause,
            before=current.fitted,
            after=after,
            is_outdone=is_outdone(current, candidate, set(refused)),
            choice=current.choice(candidate),
            probability=chosen.probability,
            rivals=current.rivals_of(candidate),
            onsets=self._onsets(candidate, current),
            is_contested=self.forms.is_contested(candidate, current, after),
        )

    def _is_restated(
        self,
        found: list[Accepted[CauseT]],
        rounds: list[Round[CauseT]],
        kinds: Sequence[CauseT],
        further: FittedModel[CauseT] | None,
    ) -> bool:
        """Give an accepted cause another form that fits clearly better; return True if one was changed."""
        restated = self.forms.restated(found, rounds[-1].fitted, further)
        if restated is None:
            return False
        found[:] = restated
        rounds[-1] = self.scored(found[-1].after, kinds, len(rounds) - 1)
        return True

    def _has_other_shape(
        self, found: list[Accepted[CauseT]], rounds: list[Round[CauseT]], kinds: Sequence[CauseT], asked: set[str]
    ) -> bool:
        """Give an accepted cause another shape, alone or with a further cause, if that explains clearly more next to
        what was found since; return True if one was changed. Each cause is ``asked`` once."""
        for step in found:
            if len(found) < 2 or not step.cause.shifts_with_others or step.cause.key in asked:
                continue
            asked.add(step.cause.key)
            others = [other for other in found if other is not step]
            causes = (*self.given, *(other.cause for other in others))
            without = self.scored(self.fitter.prepared(causes, rounds[-1].fitted), kinds, len(rounds) - 1)
            better = other_shape(self.fitter, rounds[-1].fitted, without, step.cause, causes)
            if better is not None:
                self._take_up(found, rounds, kinds, without, others, better)
                return True
        return False

    def _take_up(
        self,
        found: list[Accepted[CauseT]],
        rounds: list[Round[CauseT]],
        kinds: Sequence[CauseT],
        without: Round[CauseT],
        others: Sequence[Accepted[CauseT]],
        better: OtherShape[CauseT],
    ) -> None:
        """Accept another shape after the ``others``, and a further cause if it has one."""
        kept = fitted_in_turn(self.fitter, self.given, others, found[0].before)
        rounds[-1] = without
        for tried in better.candidates:
            current = rounds[-1]
            candidate = next(c for c in current.candidates if c.key == tried.key)
            chosen = chosen_again(current, candidate, set(), self.settings.level)
            after = self.fitter.prepared((*current.fitted.causes, candidate.cause.refined()), current.fitted)
            accepted = self.accepted(chosen, candidate.cause.refined(), current, after)
            kept.append(accepted.light(self._closed(rounds)))
            rounds.append(self.scored(after, kinds, len(rounds)))
        found[:] = kept

    def _together(
        self,
        rounds: list[Round[CauseT]],
        kinds: Sequence[CauseT],
        refused: set[str],
        unnamed: CauseCandidate[CauseT],
    ) -> list[Accepted[CauseT]]:
        """Return catalogued causes that together explain more than a nonparametric effect does; adds their rounds.

        A nonparametric effect of an input absorbs several causes that depend on it, though each of them has a form.
        They are preferred if they leave nothing real, named or not, are clearly more probable, and are not several
        names of one effect; else empty.
        """
        start, steps = rounds[-1], list[Accepted[CauseT]]()
        branch, hidden = [start], {c.kind for c in start.candidates if not c.cause.catalogued}
        lead = -start.posterior(unnamed)
        while len(steps) < _MOST_TOGETHER:
            current = branch[-1]
            chosen = choose(current, refused | hidden, self.settings.level)
            if chosen is None:
                break
            chosen, cause, after = self.fitted_form(chosen, current)
            if predicts_worse(current.fitted.held_out, after.held_out, self.covered(cause, after)):
                return []
            lead += current.posterior(chosen.candidate)
            if len(steps) == _MOST_TOGETHER - 1 and lead < np.log(RIVAL_FACTOR):
                return []  # whatever the last round would show
            choice, rivals = current.choice(chosen.candidate), current.rivals_of(chosen.candidate)
            onsets, chosen = self._onsets(chosen.candidate, current), chosen.light()
            closed = start.closed() if current is start else self._closed(branch)
            branch.append(self.scored(after, kinds, len(rounds) - 1 + len(branch)))
            probability = closed.probability_of_name(chosen.candidate, branch[-1], hidden)
            steps.append(
                Accepted(chosen, closed, cause, closed.fitted, after, False, choice, probability, rivals, onsets)
            )
        if len(steps) < 2 or lead < np.log(RIVAL_FACTOR):
            return []
        is_one = names_of_one_effect(steps, branch[-1], branch[-1].fitted)
        if is_one or choose(branch[-1], refused, self.settings.level) is not None:
            return []
        self._closed(rounds)
        rounds += branch[1:]
        together = 1.0 / (1.0 + float(np.exp(-lead)))
        return [replace(step, probability=together * step.probability) for step in steps]

    @staticmethod
    def _closed(rounds: list[Round[CauseT]]) -> Round[CauseT]:
        """Close the last round and release its fit; return the closed round."""
        if rounds[-1].search is not None:
            rounds[-1] = rounds[-1].closed()
            rounds[-1].fitted.release()
        return rounds[-1]

    def fitted_form(
        self, chosen: CandidateChoice[CauseT], current: Round[CauseT]
    ) -> tuple[CandidateChoice[CauseT], CauseT, FittedModel[CauseT]]:
        """Return the choice, its cause in the form that is fitted, and the model with it, without parts that have no
        effect."""
        while True:
            own = chosen.candidate.cause
            cause, size = own.refined(), chosen.candidate.signature.parameters
            after = self.fitter.prepared((*current.fitted.causes, cause), current.fitted)
            values, covariance = after.values(cause)
            narrower = self.forms.plainer(
                chosen.candidate, current, after, is_distinct=cause.is_distinct(values, covariance)
            )
            if narrower is chosen.candidate:
                least = own.narrowed(values[:size], covariance[:size, :size], after.model.part_count)
                narrower = next((c for c in current.candidates if c.key == least.key), chosen.candidate)
            if narrower is chosen.candidate or not is_real(current, narrower, self.settings.level):
                return chosen, cause, after
            chosen = replace(chosen, candidate=narrower, subjects=(), inputs=(), quantities=())

    @staticmethod
    def _onsets(candidate: CauseCandidate[CauseT], current: Round[CauseT]) -> tuple[CauseT, CauseT] | None:
        """Return a candidate's cause at its earliest and latest possible onset."""
        return None if current.search is None else onset_interval(candidate, current.fitted, current.search)

    def covered(self, cause: CauseT, after: FittedModel[CauseT]) -> Mask:
        """Return True for held-out epochs (B,) at which a cause claims to hold."""
        held_out = self.fitter.held_out
        if held_out is None:
            return np.ones(len(after.measured.is_observed), bool)
        return np.asarray(cause.covers(held_out.conditions.covariates, len(held_out.measured.is_observed)))

    def _dropped(
        self, found: list[Accepted[CauseT]], plain: FittedModel[CauseT]
    ) -> tuple[list[Accepted[CauseT]], list[Verdict[CauseT]], FittedModel[CauseT]]:
        """Return the accepted causes that are still needed, verdicts on the dropped ones, and the final model."""
        final, kept = found[-1].after if found else plain, list(found)
        dropped: list[Verdict[CauseT]] = []
        while (spare := self._spare(kept, found[-1] if found else None, final)) is not None:
            kept.remove(spare)
            dropped.append(first_order(spare.round, spare.candidate, REJECTED, self.fitter.held_out, Reason.DROPPED))
            final = self.fitter.prepared((*self.given, *(other.cause for other in kept)), final)
        return kept, dropped, final

    def _spare(
        self, kept: list[Accepted[CauseT]], last: Accepted[CauseT] | None, final: FittedModel[CauseT]
    ) -> Accepted[CauseT] | None:
        """Return an accepted cause that the others make needless, or None. If a name is needless, so may be an effect
        without a name that explains the same: it goes first."""

        def is_needless(step: Accepted[CauseT]) -> bool:
            return not self._is_needed(step, final, [other.cause for other in kept if other is not step])

        if len(kept) < 2:
            return None
        needless = next((step for step in kept if step is not last and is_needless(step)), None)
        if needless is None or not needless.cause.catalogued:
            return needless
        unnamed = (step for step in reversed(kept) if not step.cause.catalogued)
        return next(filter(is_needless, unnamed), needless)

    def _is_needed(self, step: Accepted[CauseT], final: FittedModel[CauseT], others: Sequence[CauseT]) -> bool:
        """Return True if an accepted cause is still significant in the final model, at the search's threshold. By
        Wald's test or, if the cause has shape parameters, by a fit without it: a poorly determined shape widens the
        uncertainty of amplitudes."""
        values, covariance = final.values(step.cause)
        size = step.candidate.signature.parameters
        null = step.round.null
        group = null.group_of(step.candidate.kind, step.candidate.signature.rank)
        limit = null.threshold(group, self.settings.level)
        squares = float(values[:size] @ np.linalg.solve(covariance[:size, :size], values[:size]))
        if null.raw(squares, group, 1.0) <= limit:
            return True
        if step.cause.key == step.candidate.key:  # no shape parameters
            return False
        without = self.fitter.comparable((*self.given, *others), final)
        gained = float(np.sum(without.fit.whitened.rest**2) - np.sum(final.fit.whitened.rest**2))
        return bool(null.raw(gained / final.noise_ratio**2, group, 1.0) <= limit)
