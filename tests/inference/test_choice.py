"""Order of acceptance of causes, and the rivals that the data cannot separate, alone or next to other causes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.inference import toy_campaign as toy
from tests.tolerance import assert_close
from truing.inference import rounds
from truing.inference.choice import CandidateChoice, choose, confirmed, is_outdone
from truing.inference.noise import components
from truing.inference.rounds import Round
from truing.inference.scores import scores_of
from truing.inference.search import CauseCandidate, Search
from truing.inference.signatures import signature

LEVEL = 0.02
# What a drive does wrong at each pose: three courses that have nothing to do with one another.
COURSES = np.random.default_rng(1).uniform(-1, 1, (3, toy.POSES))


def _cause(name: str, catalogued: bool) -> Any:
    return SimpleNamespace(
        key=name,
        catalogued=catalogued,
        has_known_scale=False,
        like_sized=lambda legs: (),
        one_sided=lambda legs: (0,) if name.startswith("gap") else (),
        is_higher_order=name.startswith("further"),
        subject=name.partition(" by ")[0].partition(" of ")[2] or name,
        inputs=lambda parts: tuple(name.partition(" by ")[2].split()),
        moved_quantity=name.partition(" of ")[0],
    )


def _design(course: NDArray, drive: int) -> dict[str, NDArray]:
    return {"drive": course[:, None, None] * np.eye(toy.DRIVES)[:, [drive]]}


def _round(
    designs: dict[str, dict[str, NDArray]], sizes: dict[str, float], unnamed: tuple[str, ...], seed: int = 2
) -> Round:
    """A round over candidates, each a kind of its own, in data that hold some at a signal-to-noise; seed: of noise."""
    clean = toy.channels(toy.measured(np.random.default_rng(0)))
    effect = np.zeros(toy.TEMPLATE.residual.shape)
    for name, size in sizes.items():
        columns = toy.TEMPLATE.by_local[..., toy.READINGS] @ designs[name]["drive"]
        effect += columns[..., 0] * size / signature(clean, designs[name]).strengths[0]
    whitened = toy.measured(np.random.default_rng(seed), effect)
    own, noise = toy.channels(whitened), components(whitened, 3 * toy.POINTS, toy.READINGS)
    stand: Any = SimpleNamespace(
        noise=noise,
        model=SimpleNamespace(part_count=0),
        fit=SimpleNamespace(whitened=whitened),
        causes=(),
        scene=SimpleNamespace(higher_order_terms=lambda cause: ()),
    )
    found = [CauseCandidate(_cause(n, n not in unnamed), n, signature(own, d), 1.0) for n, d in designs.items()]
    shares = dict.fromkeys(designs, 1.0)
    search = Search(own, noise, found, [], shares, 99, np.random.default_rng(3))
    return rounds._round(stand, search, scores_of(search.candidates, stand, search.pathways.residual))


@pytest.fixture(scope="module")
def both() -> Round:
    """An effect with a name and a stronger one without, and a twin that does on the same drive what the weak does."""
    weak, strong = _design(COURSES[0], 0), _design(COURSES[1], 1)
    twin = _design(COURSES[0] + 0.02 * COURSES[2], 0)
    return _round({"weak": weak, "strong": strong, "twin": twin}, {"weak": 20.0, "strong": 25.0}, ("strong",))


def test_a_second_real_cause_is_no_rival_of_the_first(both: Round) -> None:
    choice = choose(both, set(), LEVEL)
    assert choice is not None
    assert choice.candidate.key in ("weak", "twin")
    assert "strong" not in [rival.key for rival, _ in choice.rivals]


def test_rivals_of_a_cause_explain_as_much_next_to_the_other_real_cause(both: Round) -> None:
    choice = choose(both, set(), LEVEL)
    assert choice is not None
    assert {choice.candidate.key, *(rival.key for rival, _ in choice.rivals)} == {"weak", "twin"}
    assert all(abs(lead) < np.log(20.0) for _, lead in choice.rivals)


def test_the_probability_of_one_of_two_holds_next_to_the_other(both: Round) -> None:
    choice = choose(both, set(), LEVEL)
    assert choice is not None
    assert both.probabilities[choice.candidate.kind] < 0.05  # alone, the stronger one leaves it nothing
    assert 0.05 < choice.probability < 0.95  # its twin has the rest


def test_rivals_of_a_single_effect_are_those_that_explain_it_alone() -> None:
    designs = {"own": _design(COURSES[0], 0), "twin": _design(COURSES[0] + 0.02 * COURSES[2], 0)}
    designs["other"] = _design(COURSES[1], 1)
    choice = choose(_round(designs, {"own": 12.0}, ()), set(), LEVEL)
    assert choice is not None
    names = [rival.key for rival, _ in choice.rivals]
    assert {choice.candidate.key, *names} == {"own", "twin"}


@pytest.mark.parametrize(("size", "expected"), [(15.0, "gap"), (-15.0, "form")])
def test_a_name_is_not_given_to_what_has_the_sign_that_nature_does_not_have(size: float, expected: str) -> None:
    designs = {"gap": _design(COURSES[0], 0), "form": _design(COURSES[0] + 0.3 * COURSES[2], 0)}
    choice = choose(_round(designs, {"gap": size}, ("form",)), set(), LEVEL)
    assert choice is not None
    assert choice.candidate.key == expected


def test_a_named_cause_is_preferred_unless_another_form_explains_as_much_next_to_stronger_effects() -> None:
    designs = {"weak": _design(COURSES[0], 0), "strong of x": _design(COURSES[1], 1)}
    twin = _design(COURSES[0] + 0.02 * COURSES[2], 0)
    sizes = {"weak": 20.0, "strong of x": 25.0}
    for other, expected in (("other of x", "strong of x"), ("other of y", "weak")):
        choice = choose(_round({**designs, other: twin}, sizes, ("strong of x", other)), set(), LEVEL)
        assert choice is not None
        assert choice.candidate.key == expected


@pytest.mark.parametrize(("held", "late", "expected"), [(20.0, False, True), (20.0, True, False), (6.0, False, False)])
def test_a_small_effect_on_the_poses_of_a_larger_form_is_its_remainder(held: float, late: bool, expected: bool) -> None:
    """The form acts on the first half of the poses; a signal of 8 is small next to one of 20, not of 6."""
    first = np.arange(toy.POSES) < toy.POSES // 2
    own = _design(np.where(first ^ late, COURSES[0], 0.0), 0)
    current = _round({"name": own}, {"name": 8.0}, ())
    form = _design(np.where(first, COURSES[1], 0.0), 0)
    stand: Any = current.fitted
    stand.causes, stand.design_matrix = (_cause("form", False),), lambda cause: form
    stand.values = lambda cause: (np.array([held]), np.eye(1))
    stand.scene = SimpleNamespace(covariates={})
    assert current.is_remainder(current.candidates[0]) is expected


@pytest.mark.parametrize(("left", "is_left"), [(8.0, True), (0.0, False)])
def test_a_rival_without_a_name_that_still_explains_something_speaks_against_a_name(left: float, is_left: bool) -> None:
    name, form = _design(COURSES[0], 0), _design(COURSES[0] + 0.8 * COURSES[1], 0)
    before = _round({"name": name, "form": form}, {"name": 15.0, "form": left}, ("form",))
    after = _round({"form": form}, {"form": left}, ("form",))
    own = next(candidate for candidate in before.candidates if candidate.key == "name")
    assert (after.p_value_of_rivals(before.rivals_of(own)) < 0.005) is is_left


@pytest.mark.slow
@pytest.mark.parametrize("largest", [0.45, 0.7])
def test_chance_does_not_choose_the_rivals_of_a_right_name(largest: float) -> None:
    """Many forms with some overlap with the name, in data that hold the name alone: p-values are those of chance."""
    rng, clean, every = (
        np.random.default_rng(5),
        toy.channels(toy.measured(np.random.default_rng(0))),
        np.eye(toy.POSES),
    )
    weight = np.array([signature(clean, _design(pose, 0)).strengths[0] for pose in every])
    along = COURSES[0] * weight / np.linalg.norm(COURSES[0] * weight)
    beside = rng.normal(size=(100, toy.POSES))
    beside -= np.outer(beside @ along, along)
    beside /= np.linalg.norm(beside, axis=1)[:, None]
    overlap = rng.uniform(0.0, largest, (100, 1))
    whole = overlap * along + np.sqrt(1.0 - overlap**2) * beside
    forms, remainders = (
        {f"form {n}": _design(one / weight, 0) for n, one in enumerate(each)} for each in (whole, beside)
    )
    p_values, chosen = [], set()
    for seed in range(40):
        before = _round({"name": _design(COURSES[0], 0), **forms}, {"name": 8.0}, tuple(forms), seed)
        own = next(candidate for candidate in before.candidates if candidate.key == "name")
        rivals = before.rivals_of(own)
        chosen.add(rivals)
        p_values.append(_round(remainders, {}, tuple(forms), seed).p_value_of_rivals(rivals))
    assert chosen == {frozenset(f"form {n}" for n in np.flatnonzero(overlap[:, 0] ** 2 >= 0.25))}
    assert np.mean(np.array(p_values) < 0.05) <= 0.125


def test_an_effect_that_was_no_rival_of_a_name_does_not_speak_against_it() -> None:
    """It acts on other poses, so that the name takes nothing from it."""
    first = np.arange(toy.POSES) < toy.POSES // 2
    name, other = (_design(np.where(own, COURSES[0], 0.0), 0) for own in (first, ~first))
    before = _round({"name": name, "other": other}, {"name": 15.0, "other": 5.0}, ("other",))
    after = _round({"other": other}, {"other": 5.0}, ("other",))
    own = next(candidate for candidate in before.candidates if candidate.key == "name")
    assert after.p_value_of_rivals(before.rivals_of(own)) == 1.0


def _probability(chosen: str, before: dict[str, float], after: dict[str, float], near: float) -> float:
    """Probability of a name with effects of these sizes before and after its acceptance; ``twin`` does what ``weak``
    does, but for a share ``near`` of another course."""
    twin = _design(COURSES[0] + near * COURSES[2], 0)
    designs = {"weak": _design(COURSES[0], 0), "strong": _design(COURSES[1], 1), "twin": twin}
    first = _round(designs, before, ("strong",))
    (candidate,) = [c for c in first.candidates if c.key == chosen]
    return first.probability_of_name(candidate, _round(designs, after, ("strong",)))


def test_an_effect_that_remains_after_a_name_is_no_alternative_of_it() -> None:
    """The strong effect is no alternative of the weak one: it is there as before once that is accepted."""
    both = {"weak": 20.0, "strong": 25.0}
    assert _probability("strong", both, {"weak": 20.0}, 0.1) > 0.999
    assert _probability("weak", {"weak": 20.0}, {}, 1.0) > 0.999
    assert 0.2 < _probability("weak", both, {"strong": 25.0}, 0.1) < 0.8


def test_causes_that_no_campaign_distinguishes_are_no_alternatives() -> None:
    assert _probability("weak", {"weak": 20.0}, {}, 1e-6) > 0.999


@dataclass(frozen=True)
class _Reported:
    """A round of which only the log posterior odds of its candidates are known; all are real, unless ``p`` is large."""

    odds: dict[str, float]
    unnamed: tuple[str, ...] = ()
    accepted: tuple[Any, ...] = ()
    kinds: dict[str, str] = field(default_factory=dict)
    best_pair: Any = None
    p: float = 1e-9
    small: tuple[str, ...] = ()  # next to a form without a name that the model holds

    @property
    def fitted(self) -> Any:
        return SimpleNamespace(causes=self.accepted, model=SimpleNamespace(part_count=0))

    @cached_property
    def candidates(self) -> tuple[Any, ...]:
        own = SimpleNamespace(parameters=1)
        return tuple(
            SimpleNamespace(cause=_cause(n, n not in self.unnamed), key=n, kind=self.kinds.get(n, n), signature=own)
            for n in self.odds
        )

    @property
    def best(self) -> dict[str, Any]:
        return {c.kind: c for c in sorted(self.candidates, key=self.posterior)}

    @property
    def scores(self) -> dict[str, Any]:
        return {name: SimpleNamespace(log_evidence=1.0) for name in self.odds}

    def posterior(self, candidate: Any) -> float:
        return self.odds[candidate.key]

    def p_value(self, candidate: Any) -> float:
        return self.p

    def is_remainder(self, candidate: Any) -> bool:
        return candidate.key in self.small


def _accepted(stated: _Reported) -> str | None:
    choice = choose(cast("Round", stated), set(), LEVEL)
    return None if choice is None else choice.candidate.key


@pytest.mark.parametrize(("lead", "expected"), [(1.0, "few"), (1.2, "many")])
def test_the_kind_with_the_fewest_parameters_is_accepted_unless_another_is_three_times_as_probable(
    lead: float, expected: str
) -> None:
    reported = _Reported({"few": 10.0, "many": 10.0 + lead})
    for candidate in reported.candidates:
        candidate.signature = SimpleNamespace(parameters=1 if candidate.key == "few" else 6)
    assert _accepted(reported) == expected


@pytest.mark.parametrize(("lead", "expected"), [(0.5, "name"), (2.0, "form"), (9.0, "form")])
def test_a_name_is_given_unless_a_form_without_one_is_three_times_as_probable(lead: float, expected: str) -> None:
    assert _accepted(_Reported({"name": 10.0, "form": 10.0 + lead}, ("form",))) == expected


@pytest.mark.parametrize(
    ("name", "further", "expected"), [(2.0, 0.0, None), (4.0, 2.0, "further"), (4.0, 0.0, "name"), (9.0, 5.0, "name")]
)
def test_the_remainder_of_a_nonparametric_effect_gets_no_name(
    name: float, further: float, expected: str | None
) -> None:
    """Next to an accepted one, a name has to be twenty times as probable as none, and as that form's further terms."""
    odds = {"name": name, **({"further": further} if further else {})}
    assert _accepted(_Reported(odds, ("further",), (_cause("form", False),))) == expected
    assert _accepted(_Reported(odds, ("further",))) == ("name" if name > further else expected)


@pytest.mark.parametrize(
    ("other", "small", "expected"),
    [("other of x", (), "other of x"), ("other of y", (), "name"), ("other of y", ("name",), "other of y")],
)
def test_next_to_a_form_without_a_name_others_of_its_subject_come_first_and_a_small_name_is_none(
    other: str, small: tuple[str, ...], expected: str
) -> None:
    reported = _Reported({"name": 9.0, other: 8.0}, (other,), (_cause("form of x", False),), small=small)
    assert _accepted(reported) == expected


@pytest.mark.parametrize(("beside", "expected"), [(23.0, False), (28.0, True)])
def test_two_names_are_taken_for_one_form_only_where_they_are_more_probable_once_fitted(
    beside: float, expected: bool
) -> None:
    """As an estimate before the fit said; one of 50 stands against 27 and what is found next to that."""
    current, following = _Reported({"stronger": 27.0, "one": 50.0}, ("one",)), _Reported({"weaker": beside})
    choice = CandidateChoice(current.candidates[0], (), 1.0, of_two=True)
    assert confirmed(cast("Round", current), choice, cast("Round", following), LEVEL, set()) is expected


def test_a_named_cause_with_noise_residuals_is_kept_whatever_was_probable_before_the_fit() -> None:
    """A large effect leaves what is not linear in it to forms with more parameters, until the name is fitted."""
    current, following = _Reported({"name": 27.0, "one": 900.0}, ("one",)), _Reported({"rest": 5.0}, p=0.4)
    choice = CandidateChoice(current.candidates[0], (), 1.0, of_two=True)
    assert confirmed(cast("Round", current), choice, cast("Round", following), LEVEL, set())


def test_other_subjects_of_the_kind_are_reported_with_the_odds_against_them() -> None:
    kinds = dict.fromkeys(("leg2 leg5", "", "leg2", "leg1"), "gain")
    odds = {"leg2 leg5": 9.0, "": 8.0, "leg2": 9.0 - np.log(10.0), "leg1": 5.0, "other": 8.9}
    choice = choose(cast("Round", _Reported(odds, kinds=kinds)), set(), LEVEL)
    assert choice is not None
    assert [subject for subject, _ in choice.subjects] == ["", "leg2"]
    assert_close([against for _, against in choice.subjects], [np.e, 10.0], atol=1e-9, what="odds against")


def test_inputs_that_explain_nearly_as_well_are_reported_unless_they_hold_those_of_the_effect() -> None:
    odds = {
        "form of leg2 by time": 9.0,
        "bent of leg2 by heat": 8.0,
        "form of leg2 by heat": 6.0,
        "form of leg2 by time load": 8.5,
        "form of leg2 by load": 5.0,
        "form of leg1 by load": 8.9,
    }
    reported = _Reported(odds, tuple(odds), kinds=dict.fromkeys(odds, "unexplained"))
    choice = choose(cast("Round", reported), set(), LEVEL)
    assert choice is not None
    assert choice.subjects == ()
    ((inputs, against),) = choice.inputs
    assert inputs == ("heat",)
    assert_close(against, 1.0 / (np.exp(-1.0) + np.exp(-3.0)), atol=1e-9, what="odds against")


def test_quantities_of_the_same_part_that_explain_nearly_as_well_are_reported() -> None:
    odds = {
        "attachments of leg2 by time": 9.0,
        "readings of leg2 by time": 8.9,
        "lengths of leg2 by time": 4.0,
        "sideways of leg2 by load": 8.8,
        "lengths of leg1 by time": 8.7,
    }
    reported = _Reported(odds, tuple(odds), kinds=dict.fromkeys(odds, "unexplained"))
    choice = choose(cast("Round", reported), set(), LEVEL)
    assert choice is not None
    assert choice.candidate.cause.moved_quantity == "attachments"
    assert choice.quantities == ("readings",)


def test_a_refused_candidate_gives_way_to_a_less_probable_one() -> None:
    """A periodic error whose pitch fits the levels of the drives may absorb a gain, and fail between the levels."""
    designs = {"refused": _design(COURSES[0], 0), "less": _design(COURSES[0] + 0.5 * COURSES[2], 0)}
    current = _round(designs, {"refused": 20.0}, ())
    first, left = choose(current, set(), LEVEL), choose(current, {"refused"}, LEVEL)
    assert first is not None
    assert left is not None
    assert (first.candidate.key, left.candidate.key) == ("refused", "less")
    assert current.posterior(left.candidate) < current.posterior(first.candidate) - np.log(20.0)
    assert [rival.key for rival, _ in left.rivals] == ["less"]
    assert choose(current, {"refused", "less"}, LEVEL) is None


def test_a_name_is_outdone_by_a_more_probable_form_that_was_refused_and_by_no_other(both: Round) -> None:
    weak, strong = (next(c for c in both.candidates if c.key == key) for key in ("weak", "strong"))
    assert is_outdone(both, weak, {strong.kind})
    assert not is_outdone(both, weak, set())
    assert not is_outdone(both, strong, {weak.kind})
