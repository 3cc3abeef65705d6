"""Bodies without a mechanism that are not rigid after all: they deform with something, or drift with time.

A pattern over the targets has no part that a motion of the body as a whole would explain: that is the body's pose. Only
a body that stands still can be seen to move as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import skew
from truing.simulation.cause import Cause, Kind, Parameter, Scene, Step, Told
from truing.simulation.causes.body_terms import (
    CAME_FROM,
    ORDER,
    TIME,
    TIMES,
    counted,
    in_words,
    place_columns,
    proposed_terms,
    runs_with_time,
)
from truing.simulation.chain import State
from truing.simulation.legs import Change

_MM = 1e-3
# A plausible shift of a target over its distance from the middle of the body.
_PLAUSIBLE = 1e-4
_FEWEST = 3
# Time constants that are tried, over the length of the campaign.
_TAUS = (0.03, 0.1, 0.3, 1.0)
# Half periods of slow waves over the campaign, and how many poses each wants.
_WAVES, _POSES_PER_WAVE = 6, 25
# With more targets a pattern has so many parameters that only what is in proportion to something is tried.
_MANY_TARGETS = 30
_SHARE_OF_WAVES = 0.5
_SHARE_OF_OTHERS = 0.25
# Logarithms of ratios of time constants beyond which a drift is a line, or a step, whatever they are.
_LOG_RATIOS = (-4.0, 4.0)


@dataclass(frozen=True)
class OfBody(Cause):
    """What happens to the targets of one body; ``places`` are where they sit on it, m, one after the other.

    They shift by a pattern, or, with ``whole``, together with the body, which should stand still.
    """

    body: str = ""
    targets: tuple[str, ...] = ()
    places: tuple[float, ...] = ()
    whole: bool = False

    step = Step.STRUCTURE
    reads = frozenset()

    @property
    def subject(self) -> str:
        """Return the body."""
        return self.body

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: it moves no platform."""
        return ()

    @cached_property
    def _arms(self) -> NDArray:
        """Return where the targets sit (k, 3) from their middle."""
        places = np.reshape(self.places, (-1, 3))
        return np.asarray(places - places.mean(0))

    @cached_property
    def _radius(self) -> float:
        return float(np.sqrt(np.mean(np.sum(self._arms**2, -1))))

    @cached_property
    def _rigid(self) -> NDArray:
        """Return how the targets (3k, 6) follow a shift and a rotation of the body."""
        motions = np.concatenate([np.broadcast_to(np.eye(3), (len(self._arms), 3, 3)), -skew(self._arms)], -1)
        return motions.reshape(-1, 6)

    @cached_property
    def _shape_only(self) -> NDArray:
        """Return the matrix (3k, 3k) that takes the motion as a whole out of shifts of the targets."""
        return np.eye(len(self._rigid)) - self._rigid @ np.linalg.pinv(self._rigid)

    @cached_property
    def _pattern(self) -> NDArray:
        """Return how the targets (3k, Q) follow the parameters of one function."""
        return self._rigid if self.whole else self._shape_only

    def _moved(self, state: State, functions: NDArray) -> NDArray:
        """Return the derivative of `moved` (B, K, 3, m Q) for the pattern times functions (B, m)."""
        pattern = self._pattern
        known = () if state.targets is None else tuple(zip(state.targets.bodies, state.targets.names, strict=True))
        poses, count = functions.shape
        moved = np.zeros((poses, len(known), 3, count, pattern.shape[1]), functions.dtype)
        for row, target in enumerate(self.targets):
            if (self.body, target) in known:
                own = pattern[3 * row : 3 * row + 3]
                moved[:, known.index((self.body, target))] = functions[:, None, :, None] * own[:, None, :]
        return moved.reshape(poses, len(known), 3, -1)

    def _of_pattern(self, suffix: str = "") -> tuple[Parameter, ...]:
        """Return each target's shift, or shift and turn of the body as a whole."""
        scale, whose = _PLAUSIBLE * self._radius, ("shift",) if self.whole else self.targets
        shifts = tuple(Parameter(f"{name}_{axis}{suffix}", "mm", scale, _MM) for name in whose for axis in "xyz")
        turns = tuple(Parameter(f"turn_{axis}{suffix}", "rad", _PLAUSIBLE) for axis in "xyz")
        return (*shifts, *turns) if self.whole else shifts

    def _free_of_motion(self, values: NDArray, covariance: NDArray) -> tuple[NDArray, NDArray]:
        """Return values and covariance of a pattern without the motion as a whole, which is no part of it."""
        if self.whole:
            return values, covariance
        own = np.kron(np.eye(len(values) // len(self._shape_only)), self._shape_only)
        return own @ values, own @ covariance @ own.T


@dataclass(frozen=True)
class BodyDeformation(OfBody):
    """A body's targets shift by a pattern times columns of the campaign.

    ``terms`` are columns or products of two, as ``a*b``; ``columns`` are all that occur in them, counted from ``zeros``
    in units of ``ranges``, so that a parameter is a shift over the range that the campaign went through. ``with_time``
    says that time ran along with them: no data of the campaign tell such a deformation from a drift.
    """

    terms: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    zeros: tuple[float, ...] = ()
    ranges: tuple[float, ...] = ()
    with_time: bool = False

    id = "body-deformation"

    @property
    def key(self) -> str:
        """Return the name that tells this candidate from all others."""
        return f"{self.id} {self.body} {'whole ' if self.whole else ''}{' '.join(self.terms)}"

    @property
    def says(self) -> str:
        """Return what the body does."""
        if self.columns[0].startswith(CAME_FROM):
            way = f"after {self.columns[0].removeprefix(CAME_FROM)} went up than after it went down (hysteresis)"
            return f"body {self.body} {'stands elsewhere' if self.whole else 'keeps another shape'} {way}"
        if self.whole:
            return f"body {self.body}, which should stand still, moves as a whole with {in_words(self.terms)}"
        or_time = ", or with time, which ran along with it" if self.with_time else ""
        return f"body {self.body} deforms with {in_words(self.terms)}{or_time}"

    @property
    def confirm(self) -> str:
        """Return what to measure to confirm it."""
        column = self.columns[0].removeprefix(CAME_FROM)
        return f"Change {column} alone, up and down through its range, and measure {self.body} at every step."

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return every body with every drive, the temperature, squares, products and directions of approach."""
        if scene.legs:
            return ()
        proposed = list(proposed_terms(scene))
        return [
            BodyDeformation(*own, whole, terms, *counted(scene, terms), runs_with_time(scene, terms))
            for own in _bodies_of(scene)
            for whole in _wholes(scene, own[0])
            for terms in proposed
            if terms != place_columns(own[0])
            if whole or not _is_large(own[1]) or (len(terms) == 1 and TIMES not in terms[0])
        ]

    def prior(self, scene: Scene) -> float:
        """Return the share of these terms: what is in proportion to one column is likelier than all else."""
        alone = len(self.terms) == 1 and TIMES not in self.terms[0] and not self.terms[0].startswith(CAME_FROM)
        return 1.0 if alone else _SHARE_OF_OTHERS

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return each target's shift x, y, z over the range of each term, mm."""
        if len(self.terms) == 1:
            return self._of_pattern()
        return tuple(parameter for n in range(len(self.terms)) for parameter in self._of_pattern(f"_{n + 1}"))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d moved / d shift = the term's value, free of a motion of the body as a whole."""
        return Change({"moved": self._moved(state, self._functions(state))}, len(self.terms) * self._pattern.shape[1])

    def told(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[Told, ...]:
        """Return the pattern, and what it follows."""
        found = super().told(*self._free_of_motion(values, covariance), legs)
        return (*found, Told("driver", " ".join(self.terms), None, ""))

    def _functions(self, state: State) -> NDArray:
        """Return the terms' values (B, m)."""
        counted = {
            name: (np.asarray(state.covariates[name]) - zero) / span
            for name, zero, span in zip(self.columns, self.zeros, self.ranges, strict=True)
        }
        return np.stack([np.prod([counted[name] for name in term.split(TIMES)], axis=0) for term in self.terms], -1)


@dataclass(frozen=True)
class BodyDrift(OfBody):
    """A body drifts with time: its targets shift by a pattern, or, where it stands still, it moves as a whole.

    ``column`` (time_s, or the order of the poses) runs from ``start`` over ``span``; the drift is linear, goes with
    1 - exp(-t / tau), or, smooth but of no simple form, as so many slow ``waves``. With ``tau_is_fitted`` the last
    parameter is the logarithm of the time constant over ``tau``.
    """

    column: str = TIME
    start: float = 0.0
    span: float = 1.0
    tau: float = 0.0
    waves: int = 0
    tau_is_fitted: bool = False

    id = "body-drift"
    kind = Kind.SHAPED
    share = 0.5  # where a drive only went one way, it is likelier to be what a body follows than time

    @property
    def key(self) -> str:
        """Return the name that tells this candidate from all others."""
        form = f"{self.waves} waves" if self.waves else f"tau={self.tau:.6g}" if self.tau else "linear"
        return f"{self.form_of} {form}"

    @property
    def form_of(self) -> str:
        """Return what drifts: its courses exclude each other."""
        return f"{self.id} {self.body} {'whole' if self.whole else 'pattern'} {self.column}"

    @property
    def says(self) -> str:
        """Return what the body does."""
        how = ", smoothly to and fro" if self.waves else ", fast at first and slower later" if self.tau else ""
        over = "time" if self.column == TIME else "the order of the poses"
        if self.whole:
            return f"body {self.body}, which should stand still, moves as a whole with {over}{how}"
        return f"the shape of body {self.body} drifts with {over}{how}"

    @property
    def confirm(self) -> str:
        """Return what to measure to confirm it."""
        return f"Measure {self.body} again and again with nothing moved, until it has come to rest."

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return every body with every form of drift; as a whole only where it should stand still.

        None where a drive ran along with time: what it would explain is told of the drive.
        """
        column = TIME if scene.varies(TIME) else ORDER
        if scene.legs or not scene.varies(column) or any(runs_with_time(scene, (d,)) for d in scene.drives):
            return ()
        start, end = _ends(scene, column)
        span, waves = end - start, min(_WAVES, len(scene.poses) // _POSES_PER_WAVE)
        forms = [(tau * span, 0) for tau in (0.0, *_TAUS)] + ([(0.0, waves)] if waves > 1 else [])
        return [
            BodyDrift(*own, whole, column, start, span, *form)
            for own in _bodies_of(scene)
            for whole in _wholes(scene, own[0])
            for form in (forms[:1] if _is_large(own[1]) and not whole else forms)
        ]

    def prior(self, scene: Scene) -> float:
        """Return the share of this form: as likely linear as with any time constant, less so without simple form."""
        return _SHARE_OF_WAVES if self.waves else 1.0 / len(_TAUS) if self.tau else 1.0

    def refined(self) -> Cause:
        """Return the drift with its time constant among the parameters."""
        return replace(self, tau_is_fitted=True) if self.tau else self

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the drift from the first to the last pose: each target's, or of the body as a whole; tau."""
        if self.waves:
            return tuple(parameter for n in range(self.waves) for parameter in self._of_pattern(f"_wave{n + 1}"))
        return (*self._of_pattern(), *((Parameter("tau", "1", 1.0),) if self.tau_is_fitted else ()))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d moved / d drift, and by the time constant."""
        if self.waves:
            x = (np.asarray(state.covariates[self.column]) - self.start) / self.span
            functions = (np.cos(np.pi * x[:, None] * np.arange(1, self.waves + 1)) - 1.0) / 2.0
            return Change({"moved": self._moved(state, functions)}, self.waves * self._pattern.shape[1])
        size = self._pattern.shape[1]
        value, slope = self._course(state, values[size] if self.tau_is_fitted else 0.0)
        moved = self._moved(state, value[:, None])
        if self.tau_is_fitted:
            by_tau = self._moved(state, slope[:, None]) @ values[:size]
            moved = np.concatenate([moved, by_tau[..., None]], -1)
        return Change({"moved": moved}, moved.shape[-1])

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return how far the targets have drifted, (B, K, 3)."""
        if not self.tau_is_fitted:
            return super().shift(state, values)
        size = self._pattern.shape[1]
        return {"moved": self.change(state, values).fields["moved"][..., :size] @ values[:size]}

    def told(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[Told, ...]:
        """Return the drift from the first to the last pose, and the time constant in units of its column."""
        size, plain = self._pattern.shape[1], replace(self, tau_is_fitted=False, waves=0)
        whole = np.kron(np.arange(1, self.waves + 1) % 2 * -1.0, np.eye(size)) if self.waves else np.eye(size)
        end = whole @ values[: whole.shape[1]], whole @ covariance[: whole.shape[1], : whole.shape[1]] @ whole.T
        found = super(BodyDrift, plain).told(*self._free_of_motion(*end), legs)
        if not self.tau_is_fitted:
            return found
        tau = self.tau * float(np.exp(np.clip(values[size], *_LOG_RATIOS)))
        unit = "s" if self.column == TIME else "poses"
        return (*found, Told("tau", tau, tau * float(np.sqrt(covariance[size, size])), unit))

    def _course(self, state: State, log_ratio: Any) -> tuple[NDArray, NDArray]:
        """Return the course of the drift (B,), 0 at the start and 1 at the end, and its slope by the log of tau."""
        x = (np.asarray(state.covariates[self.column]) - self.start) / self.span
        if not self.tau:
            return x, np.zeros_like(x)
        bounded = sorted((*_LOG_RATIOS, log_ratio), key=np.real)[1]
        rate = self.span / self.tau * np.exp(-bounded)
        whole = -np.expm1(-rate)
        value = -np.expm1(-rate * x) / whole
        by_rate = (x * np.exp(-rate * x) - value * np.exp(-rate)) / whole
        return value, -rate * by_rate


def _bodies_of(scene: Scene) -> Iterator[tuple[str, tuple[str, ...], tuple[float, ...]]]:
    """Yield each body with enough targets: its name, its targets, where they sit."""
    for body in dict.fromkeys(scene.targets.bodies):
        own = [n for n, other in enumerate(scene.targets.bodies) if other == body]
        if len(own) >= _FEWEST:
            yield body, tuple(scene.targets.names[n] for n in own), tuple(float(x) for x in scene.shape[own].ravel())


def _is_large(targets: tuple[str, ...]) -> bool:
    return len(targets) > _MANY_TARGETS


def _wholes(scene: Scene, body: str) -> tuple[bool, ...]:
    """Return whether a body may shift as a pattern, or also as a whole."""
    return (False, True) if body in scene.still else (False,)


def _ends(scene: Scene, column: str) -> tuple[float, float]:
    """Return the first and the last time of the campaign."""
    if column == TIME and scene.span_s is not None:
        return scene.span_s
    values = scene.covariates[column]
    return float(values.min()), float(values.max())
