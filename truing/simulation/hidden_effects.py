"""Effects to hide in a simulated campaign: of every sort that its layout could show, in no particular direction."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Effect, Scene

_WHOLE = "the whole"
# What is named by a word and its own name: ``target P07``, ``load fz``, ``run 4 channel dz``, ``camera left``.
_NAMED = ("target", "load", "channel", "signal", "run", "camera", "bar", "window")
# Patterns of an effect's parameters, over which its size is told.
_PATTERNS = 32
# What grows by less than this with twice the size does not grow.
_GROWN = 1.2


@dataclass(frozen=True)
class Size:
    """How large an effect is, as the tables tell it: the root mean square of one sort of its parameters.

    ``beside`` names parameters of other units that grow with it.
    """

    parameter: str
    value: float
    unit: str
    beside: str = ""


@dataclass(frozen=True)
class Sort:
    """Effects of one sort: a kind of cause on the whole, on one leg or on one target, with the same parameters.

    ``causes`` are all of them that the campaign could show, ``weights`` how probable each is beforehand.
    """

    kind: str
    concerns: str  # the whole, one leg, one target
    causes: tuple[Cause, ...]
    weights: NDArray

    def draw(self, size: float, legs: int, rng: np.random.Generator) -> Effect:
        """Return one of them at a size: the root mean square of its parameters, in plausible scales."""
        cause = self.causes[int(rng.choice(len(self.causes), p=self.weights))]
        return Effect(cause, _values(cause, size, legs, rng))


def _values(cause: Cause, size: float, legs: int, rng: np.random.Generator) -> NDArray:
    """Return parameters (P,), SI, in no particular direction, whose root mean square is a size in plausible scales."""
    scale = np.array([parameter.scale for parameter in cause.parameters(legs)])
    return size * scale * _normed(rng.standard_normal(len(scale)))


def _normed(patterns: NDArray) -> NDArray:
    """Return patterns (..., P) whose root mean square is one."""
    return np.asarray(patterns * np.sqrt(patterns.shape[-1]) / np.linalg.norm(patterns, axis=-1, keepdims=True))


@lru_cache(maxsize=256)
def _patterns(parameters: int) -> tuple[NDArray, NDArray]:
    """Return patterns (N, P) in no particular direction, and how often each was drawn: of one parameter, its signs."""
    drawn = _normed(np.random.default_rng(0).standard_normal((_PATTERNS, parameters)))
    return np.unique(drawn, axis=0, return_counts=True)


def told_size(cause: Cause, size: float, legs: int) -> Size:
    """Return a size in plausible scales as the tables tell it.

    Of the parameters that grow with it (a phase does not; the angle of a lost cosine grows with its root) it is told by
    the last, and others of its unit.
    """
    once, twice = (_root_mean_squares(cause, factor * size, legs) for factor in (1.0, 2.0))
    growing = [key for key in once if np.isclose(twice[key], 2.0 * once[key], rtol=0.05)]
    growing = growing or [key for key in once if twice[key] > _GROWN * once[key]]
    if not growing:  # a count is told as a whole number
        first = cause.parameters(legs)[0]
        return Size(first.name, size * first.scale / first.si, first.unit)
    unit = growing[-1][1]
    alike = [key for key in growing if key[1] == unit]
    value = float(np.sqrt(np.mean([once[key] ** 2 for key in alike])))
    return Size(" ".join(name for name, _ in alike), value, unit, " ".join(n for n, other in growing if other != unit))


def _root_mean_squares(cause: Cause, size: float, legs: int) -> dict[tuple[str, str], float]:
    """Return, by name (without leg, where several have it) and unit, the size of what the tables tell of an effect."""
    found: dict[tuple[str, str], list[float]] = defaultdict(list)
    names: dict[tuple[str, str], set[str]] = defaultdict(set)
    scale = np.array([parameter.scale for parameter in cause.parameters(legs)])
    for pattern, count in zip(*_patterns(len(scale)), strict=True):
        for told in cause.reported(size * scale * pattern, np.zeros((len(scale), len(scale))), legs):
            if isinstance(told.value, (int, float)) and told.sigma is not None:
                key = (told.name.rstrip("0123456789_"), told.unit)
                found[key] += [told.value] * count
                names[key].add(told.name)
    alone = {key: own.pop() if len(own) == 1 else key[0] for key, own in names.items()}
    return {(alone[key], key[1]): float(np.sqrt(np.mean(np.square(own)))) for key, own in found.items()}


def sorts(kinds: Iterable[Cause], scene: Scene) -> list[Sort]:
    """Return the sorts of effect that kinds of cause could bring into a campaign, those on the whole first."""
    found: dict[tuple[str, ...], list[Cause]] = {}
    for kind in kinds:
        for cause in (*kind.candidates(scene), *_members(kind, scene)):
            concerns = concerned(cause.subject)
            if concerns is not None and cause.parameters(scene.legs):
                found.setdefault((kind.id, concerns, *_kind_of_parameters(cause, scene.legs)), []).append(cause)
    ordered = sorted(found.items(), key=lambda item: item[0][1] != _WHOLE)
    return [Sort(key[0], key[1], tuple(causes), _weights(causes, scene)) for key, causes in ordered]


def _members(kind: Cause, scene: Scene) -> Iterable[Cause]:
    for profiles in kind.channel_candidates(scene):
        for shape, target in np.argwhere(profiles.usable):
            yield profiles.member(int(target), int(shape))


def concerned(subject: str) -> str | None:
    """Return what a subject is: the whole, one leg, one target, one load; None for several of them."""
    if not subject:
        return _WHOLE
    words = subject.split()
    if len(words) == 1:
        return f"one {subject.rstrip('0123456789')}"
    return f"one {words[0]}" if words[0] in _NAMED else None


def _kind_of_parameters(cause: Cause, legs: int) -> tuple[str, ...]:
    names = [f"{p.name.rstrip('0123456789_')} {p.unit}" for p in cause.parameters(legs)]
    return tuple(dict.fromkeys(names))


def _weights(causes: Iterable[Cause], scene: Scene) -> NDArray:
    weights = np.array([cause.prior(scene) for cause in causes])
    return weights / weights.sum()
