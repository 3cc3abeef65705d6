"""Tests of an accepted name against random courses of its own effect.

An effect moves its pathways in a few patterns, each along a course over the epochs. A name claims the courses. Here the
patterns are kept, and a course is a random function instead: of any input, of its history, a walk in time, or without
any order. Such a course must explain nothing next to the name, nor must the name's own course with a size that varies
with an input; and it must be clearly less probable in its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeAlias

import numpy as np

from truing.inference.arrays import Array
from truing.inference.evidence import log_evidence
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT
from truing.inference.random_courses import random_courses, random_factors
from truing.inference.rounds import NAME_LOG_ODDS, RIVAL_FACTOR
from truing.inference.scores import parts_of
from truing.inference.search import total_of
from truing.inference.signatures import Pathways, signatures_of

# Patterns that hold less than this share of an effect's squares are not tested, nor more than so many.
_LEAST_PATTERN, _MOST_PATTERNS = 0.1, 3
_LEAST_LOADING = 1e-6  # of a pathway in a pattern of unit length
_CLEAR_LOADING = 1e-4  # its square is far above the rounding of products
_FEWEST_EPOCHS = 12
_CHANCE = 0.01  # p-value above which patterns that are not tested hold no more than noise
_MOST_PRODUCTS = 2e11  # of numbers, about a minute
_ALIKE = 0.7  # cosine of two patterns from which on one course may be behind both

# A name is found from odds of 9 on, as among names; beforehand it is three times as probable as a random course, as it
# is in the search.
_LEAST_LEAD = float(np.log(9.0)) - NAME_LOG_ODDS
_SAME_COURSE = 0.01  # share of a name's squares that may differ from functions that are the same effect

# Inputs that a course follows; none if it walks in time or has no order.
Inputs: TypeAlias = tuple[str, ...]


@dataclass(frozen=True)
class MovedPattern:
    """One pattern of an effect: the change (C,) of each pathway, for its course (B, 1) of unit mean square.

    ``possible``: courses (B, q) of unit mean square, without correlation, of which its law allows any sum.
    """

    pathways: Mapping[str, Array]
    course: Array
    possible: Array


@dataclass(frozen=True)
class _Moved(Generic[CauseT]):
    """Patterns of an effect as pathways of a fitted model, named by their number; a course is a thin design over
    them."""

    fitted: FittedModel[CauseT]
    pathways: Pathways

    def evidences(self, designs: Sequence[Mapping[str, Array]]) -> list[tuple[float, float]]:
        """Return the log odds of random combinations of the columns of each design, and the squares that they explain
        beyond chance."""
        along = self.pathways.residual
        total, freedom = total_of(self.fitted)
        result = []
        for signature_of_design in signatures_of(self.pathways, designs):
            parts = parts_of(signature_of_design, along)
            odds = (
                float(log_evidence(parts, signature_of_design.strengths, total, freedom))
                if signature_of_design.rank
                else 0.0
            )
            result.append((odds, max(float(parts @ parts) - signature_of_design.rank * total / freedom, 0.0)))
        return result


@dataclass(frozen=True)
class CourseRival:
    """The most probable random course against a name: the inputs that it ``follows``, and its log odds ``beside`` the
    name. ``behind``: log odds lost in place of the name, infinite where the name has too many patterns.

    ``share``: squares that the name explains, over those that it and the course next to it explain beyond chance.
    """

    follows: Inputs
    beside: float
    behind: float
    share: float

    @property
    def is_clear(self) -> bool:
        """True if the name is clearly more probable than random courses, and none acts next to it."""
        return not self.is_beside and bool(self.behind >= _LEAST_LEAD)

    @property
    def is_beside(self) -> bool:
        """True if a random course acts next to the name."""
        return bool(self.beside > np.log(RIVAL_FACTOR))


def course_rival(
    final: FittedModel[CauseT], without: FittedModel[CauseT], cause: CauseT, size: int, choice: float
) -> CourseRival | None:
    """Return the random courses against a cause of the ``final`` model; None where there are too few epochs,
    or too many values.

    ``without`` is the final model without the cause; all parameters after the first ``size`` are the cause's shape;
    ``choice`` is the evidence averaged over all shapes that it may have on its subject, relative to that of its own.
    """
    from scipy.special import chdtri

    patterns, left = _patterns_of(final, cause, size)
    if not patterns:
        return None
    effect_courses = np.concatenate([pattern.course for pattern in patterns], 1)
    courses = {
        follows: unlike
        for follows, several in random_courses(final).items()
        if (unlike := [functions for functions in several if not _are_alike(functions, effect_courses)])
    }
    if _are_too_many(patterns, courses):
        return None
    motions, places = [pattern.pathways for pattern in patterns], range(len(patterns))
    moved_beside, moved = (_Moved(model, model.pathways.combined(motions)) for model in (final, without))
    factors = random_factors(final)
    varied = [_with_varied(courses, pattern.course, factors) for pattern in patterns]
    likeliest = [_likeliest(moved_beside, place, varied[place]) for place in places]
    instead = [_likeliest(moved, place, courses) for place in places]
    named, behind = _lead(moved, patterns, instead)
    behind += _gained_by_refit(final, without, named, sum(pattern.possible.shape[1] for pattern in patterns))
    if left > chdtri(max(size - len(patterns), 1), _CHANCE):  # random courses would absorb patterns that are not tested
        behind = np.inf
    next_to_it = max(likeliest, key=lambda rival: rival.odds)
    odds = next_to_it.odds - np.log(len(patterns))
    is_beside = odds > np.log(RIVAL_FACTOR)
    chosen = next_to_it if is_beside else max(instead, key=lambda rival: rival.odds)
    share = named / max(named + (next_to_it.squares if is_beside else 0.0), 1e-300)
    return CourseRival(chosen.follows, float(odds), float(behind + np.log(choice)), share)


def lead_over_one_course(
    final: FittedModel[CauseT], without: FittedModel[CauseT], causes: Sequence[tuple[CauseT, int]]
) -> float:
    """Return the log evidence for several causes of the ``final`` model over one random course in place of all of them.

    ``without`` is that model without them; each cause comes with the number of its parameters before those of its
    shape. Infinite where the causes do not move the same in one pattern, or where courses cannot be tested.
    """
    if any(not move_alike(final, causes[0], other) for other in causes[1:]):
        return np.inf
    patterns = [pattern for cause in causes for pattern in _patterns_of(final, *cause)[0][:1]]
    courses = random_courses(final)
    if not patterns or _are_too_many(patterns, courses):
        return np.inf
    moved = _Moved(without, without.pathways.combined([patterns[0].pathways]))
    instead = _likeliest(moved, 0, courses)
    named, _ = moved.evidences([_design(0, np.concatenate([pattern.possible for pattern in patterns], 1))])[0]
    return named - instead.odds


def _are_too_many(patterns: Sequence[MovedPattern], courses: Mapping[Inputs, Sequence[Array]]) -> bool:
    """Return True if products with all functions of the courses would take about a minute or more."""
    width = max(int(sum(np.count_nonzero(part) for part in pattern.pathways.values())) for pattern in patterns)
    functions = sum(functions_of_input.shape[1] for several in courses.values() for functions_of_input in several)
    return bool(len(patterns[0].course) * width**2 * functions > _MOST_PRODUCTS)


def _with_varied(
    courses: Mapping[Inputs, Sequence[Array]], course: Array, factors: Mapping[Inputs, Array]
) -> dict[Inputs, list[Array]]:
    """Return random courses, and next to them the course (B, 1) of a name with a size that varies with each input."""
    varied = {follows: course * functions for follows, functions in factors.items()}
    result = {follows: list(several) for follows, several in courses.items()}
    for follows, functions in varied.items():
        if not _are_alike(functions, course):
            result.setdefault(follows, []).append(functions)
    return result


def _are_alike(functions: Array, courses: Array) -> bool:
    """Return True if functions (B, m) of an input span no more than the courses (B, n) of a name.

    Both are then the same effect, for example if the input has only two values.
    """
    about, centred_courses = functions - functions.mean(axis=0), courses - courses.mean(axis=0)
    if spans_more(about, centred_courses.shape[1]):
        return False
    basis, sizes, _ = np.linalg.svd(about, full_matrices=False)
    basis = basis[:, sizes > _LEAST_LOADING * max(float(sizes[0]), 1e-300)]
    residual = centred_courses - basis @ (basis.T @ centred_courses)
    return basis.shape[1] <= centred_courses.shape[1] and bool(
        np.sum(residual**2) < _SAME_COURSE * np.sum(centred_courses**2)
    )


def spans_more(functions: Array, most: int) -> bool:
    """Return True if functions (B, m) clearly span more than ``most`` dimensions: by the eigenvalues of their products,
    which a singular value decomposition takes far longer to refine."""
    if min(functions.shape) <= most:
        return False
    sizes = np.linalg.eigvalsh(functions.T @ functions)[::-1]  # largest first; the squares of the singular values
    return bool(sizes[most] > _CLEAR_LOADING**2 * sizes[0])


def move_alike(final: FittedModel[CauseT], first: tuple[CauseT, int], second: tuple[CauseT, int]) -> bool:
    """Return True if the leading patterns of two causes are alike, so that one course may be behind both.

    Each comes with the number of its parameters before those of its shape.
    """
    patterns = [pattern for effect in (first, second) for pattern in _patterns_of(final, *effect)[0][:1]]
    names = tuple(final.pathways.places)
    weight, places = _sensitivity(final.pathways, names), final.pathways.places
    motions = [
        np.concatenate([pattern.pathways.get(name, np.zeros(places[name].stop - places[name].start)) for name in names])
        * weight
        for pattern in patterns
    ]
    if len(motions) < 2:
        return True
    return bool(abs(motions[0] @ motions[1]) > _ALIKE * np.linalg.norm(motions[0]) * np.linalg.norm(motions[1]))


@dataclass(frozen=True)
class _Courses:
    """Random courses of a pattern: their log odds over none, averaged over all inputs; and of the most probable ones
    the log odds, the functions (B, m), the squares explained beyond chance, and the inputs followed."""

    odds: float
    best: float
    functions: Array
    squares: float
    follows: Inputs = ()


def _likeliest(moved: _Moved[CauseT], place: int, courses: Mapping[Inputs, Sequence[Array]]) -> _Courses:
    """Return the random courses of the pattern at a place."""
    every = iter(moved.evidences([_design(place, functions) for several in courses.values() for functions in several]))
    best_of_inputs = []
    for follows, several in courses.items():
        of_input = [
            _Courses(odds, odds, functions, squares) for functions, (odds, squares) in zip(several, every, strict=False)
        ]
        best = max(of_input, key=lambda rival: rival.odds)
        odds = float(np.logaddexp.reduce([rival.odds for rival in of_input]) - np.log(len(of_input)))
        best_of_inputs.append(replace(best, odds=odds, follows=follows))
    odds = float(np.logaddexp.reduce([rival.odds for rival in best_of_inputs]) - np.log(len(best_of_inputs)))
    return replace(max(best_of_inputs, key=lambda rival: rival.odds), odds=odds)


def _design(place: int, functions: Array) -> dict[str, Array]:
    """Return the design (B, 1, m) of the pattern at a place along functions (B, m)."""
    return {str(place): functions[:, None]}


def _together(functions: Sequence[Array]) -> dict[str, Array]:
    """Return the design of all patterns, each along functions (B, m_i) of its own."""
    ends = np.cumsum([functions_of_pattern.shape[1] for functions_of_pattern in functions])
    wide = [np.zeros((len(functions_of_pattern), 1, int(ends[-1]))) for functions_of_pattern in functions]
    for functions_of_pattern, design, end in zip(functions, wide, ends, strict=True):
        design[:, 0, end - functions_of_pattern.shape[1] : end] = functions_of_pattern
    return {str(index): design for index, design in enumerate(wide)}


def _lead(moved: _Moved[CauseT], patterns: Sequence[MovedPattern], instead: Sequence[_Courses]) -> tuple[float, float]:
    """Return the squares that the courses of a name explain, and their log odds over random courses in their place.

    All patterns together: each alone would absorb a part of the others. A random course pays for the choice among all,
    a name for all courses that its law allows: with many parameters it fits any course, too.
    """
    both = [pattern.possible for pattern in patterns], [rival.functions for rival in instead]
    (named, squares), (free, _) = moved.evidences([_together(functions) for functions in both])
    return squares, named - free - sum(rival.odds - rival.best for rival in instead)


def _gained_by_refit(final: FittedModel[CauseT], without: FittedModel[CauseT], named: float, courses: int) -> float:
    """Return the log odds that a name gains by its refit: a large effect is not linear in its parameters, and random
    courses absorb what the linear name leaves."""
    total, freedom = total_of(without)
    left = total - named - courses * total / freedom
    refit, _ = total_of(final)
    return max(0.0, freedom / 2.0 * float(np.log(max(left, refit) / refit)))


def _patterns_of(fitted: FittedModel[CauseT], cause: CauseT, size: int) -> tuple[list[MovedPattern], float]:
    """Return the leading patterns of an effect that the model holds, and the squares of all others, in units of the
    noise."""
    pathways, designs = fitted.pathways, fitted.design_matrix(cause)
    epochs = len(pathways.columns)
    names = tuple(name for name in pathways.places if name in designs)
    if epochs < _FEWEST_EPOCHS or not names:
        return [], 0.0
    scale = np.array([parameter.scale for parameter in cause.parameters(fitted.model.part_count)])
    values = (fitted.values(cause)[0] / scale)[:size]
    parts = [np.broadcast_to(designs[name][..., :size] @ values, (epochs, designs[name].shape[1])) for name in names]
    weight = _sensitivity(pathways, names)
    effect = np.concatenate(parts, 1) * weight
    _, sizes, along = np.linalg.svd(effect, full_matrices=False)  # largest first
    ends = np.cumsum([part.shape[1] for part in parts])[:-1]
    pattern_count = int(np.sum(sizes[:_MOST_PATTERNS] ** 2 > _LEAST_PATTERN * np.sum(sizes**2)))
    moved_patterns = []
    for size_of_it, loading in zip(sizes[:pattern_count], along, strict=False):
        unit = size_of_it / np.sqrt(epochs)
        clear_loading = np.where(np.abs(loading) > _LEAST_LOADING, loading, 0.0)
        pattern = np.split(unit * clear_loading / np.where(weight > 0.0, weight, 1.0), ends)
        course, moved = (effect @ loading / unit)[:, None], [designs[name][..., :size] for name in names]
        broadcast_motions = [np.broadcast_to(motion, (epochs, *motion.shape[1:])) for motion in moved]
        possible = _without_correlation(np.einsum("bcp,c->bp", np.concatenate(broadcast_motions, 1), weight * loading))
        moved_patterns.append(MovedPattern(dict(zip(names, pattern, strict=True)), course, possible))
    return moved_patterns, float(np.sum(sizes[pattern_count:] ** 2))


def _without_correlation(courses: Array) -> Array:
    """Return courses (B, q) of unit mean square that span the same as courses (B, P)."""
    directions, sizes, _ = np.linalg.svd(courses, full_matrices=False)
    return np.asarray(np.sqrt(len(directions)) * directions[:, sizes > _LEAST_LOADING * max(float(sizes[0]), 1e-300)])


def _sensitivity(pathways: Pathways, names: tuple[str, ...]) -> Array:
    """Return the mean signal-to-noise ratio (C,) of a unit change of each pathway."""
    index = pathways.index(names)
    return np.asarray(np.sqrt(np.diagonal(pathways.gram, axis1=1, axis2=2)[:, index].mean(0)))
