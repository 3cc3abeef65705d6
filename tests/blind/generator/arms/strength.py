"""Strength of an effect: root of its non-centrality after a least-squares fit of all unknowns.

Not known: the base's place in each measurement frame or the stations' places, that of the tool whose poses are
measured, the targets' places (to the survey's noise where surveyed), the geometry (to its tolerance; where none is
declared links are free and zeros exact, as the campaign format says), the exact readings (to their noise). Derivatives
are differences of the generator's own chain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.arms.arm import Arm
from tests.blind.generator.arms.effects import Effect, hide
from tests.blind.generator.arms.geometry import Design, Tolerance
from tests.blind.generator.arms.instrument import Instrument, Seen, largest, rows, see
from tests.blind.generator.arms.motion import at_rest
from tests.blind.generator.arms.schedule import Schedule
from tests.blind.generator.arms.transforms import Array, rotation

STEP = 1e-6  # m and rad
FREE = 1.0  # m and rad: prior of what nothing is known of
UNDECLARED = Tolerance(0.0, FREE, FREE)


@dataclass(frozen=True)
class Bench:
    """All of a campaign except what is hidden and the noise; ``joint_noise`` (K,) in m or rad."""

    design: Design
    tolerance: Tolerance | None
    schedule: Schedule
    instrument: Instrument
    joint_noise: Array

    def joint_kind(self, column: int) -> str:
        """Kind of an actuated joint."""
        return self.design.arm.joints[self.design.arm.actuated[column]].kind

    def exact(self, effects: Sequence[Effect] = (), arm: Arm | None = None) -> Seen:
        """Measurement without noise; of the nominal arm by default."""
        own = arm or self.design.arm
        state = hide(effects, own, self.schedule, len(self.instrument.targets))
        return see(self.instrument, self.schedule, own, state)


@dataclass(frozen=True)
class Fit:
    """A linear fit: ``white`` (N, R, R) whitens a pose's rows, ``basis`` (Q, C) spans the space that the fit
    absorbs."""

    bench: Bench
    reference: Seen
    white: Array
    basis: Array

    def left(self, effect: Effect) -> Array:
        """Part (Q,) of an effect of its size that a fit does not absorb, in units of noise."""
        change = rows(self.bench.instrument, self.bench.exact([effect]), self.reference)
        seen = _stacked(self.white, change[:, :, None])[:, 0]
        seen = np.concatenate([seen, np.zeros(len(self.basis) - len(seen))])
        return np.asarray(seen - self.basis @ (self.basis.T @ seen))

    def strength(self, effect: Effect) -> float:
        """Signal-to-noise of one effect."""
        return float(np.linalg.norm(self.left(effect)))

    def displacement(self, effect: Effect) -> float:
        """Largest displacement, m, that an effect brings."""
        return largest(self.bench.instrument, self.bench.exact([effect]), self.reference)


def apart(fit: Fit, effects: Sequence[Effect]) -> list[float]:
    """Signal-to-noise of each effect where the others are fitted too."""
    seen = np.stack([fit.left(effect) for effect in effects], axis=1)
    return [float(1.0 / np.sqrt(part)) for part in np.diag(np.linalg.pinv(seen.T @ seen))]


def of_scatter(squares: float, count: int) -> float:
    """Signal-to-noise of ``count`` numbers that scatter, from the non-centrality of what they were drawn as.

    It is the root of the deviance of their mean square; their single values tell nothing.
    """
    return float(np.sqrt(squares - count * np.log1p(squares / count)))


def squares_of_scatter(wanted: float, count: int) -> float:
    """The non-centrality that such numbers need for a signal-to-noise, by bisection of its logarithm."""
    low, high = -5.0, 30.0
    for _ in range(60):
        middle = (low + high) / 2.0
        enough = of_scatter(float(np.exp(middle)), count) > wanted
        low, high = (low, middle) if enough else (middle, high)
    return float(np.exp(high))


def linear_fit(bench: Bench) -> Fit:
    """The fit of a campaign at its nominal arm; poses that are held out count for nothing."""
    reference = bench.exact()
    own = np.concatenate([_of_readings(bench, reference), _of_frames(bench, reference)], axis=2)
    white = np.linalg.inv(np.linalg.cholesky(np.eye(own.shape[1]) + own @ np.swapaxes(own, 1, 2)))
    white = white * ~bench.schedule.held_out[:, None, None]
    common = np.stack(
        [*_of_base(bench, reference), *_of_places(bench, reference), *_of_geometry(bench, reference)], axis=2
    )
    above = _stacked(white, common)
    basis, _ = np.linalg.qr(np.concatenate([above, np.eye(above.shape[1])]))
    return Fit(bench, reference, white, basis)


def _stacked(white: Array, columns: Array) -> Array:
    """Whitened columns (N R, C) of (N, R, C)."""
    return np.asarray((white @ columns).reshape(-1, columns.shape[2]))


def _derivative(bench: Bench, reference: Seen, changed: Seen, scale: float) -> Array:
    return rows(bench.instrument, changed, reference) / STEP * scale


def _of_readings(bench: Bench, reference: Seen) -> Array:
    """Derivatives (N, R, K) by each pose's readings, times the readings' noise."""
    count, instrument = len(bench.joint_noise), bench.instrument
    columns = []
    for k in range(count):
        moved = bench.schedule.readings + STEP * np.eye(count)[k]
        state = at_rest(bench.design.arm, moved, len(instrument.targets))
        changed = see(instrument, bench.schedule, bench.design.arm, state)
        columns.append(_derivative(bench, reference, changed, bench.joint_noise[k]))
    return np.stack(columns, axis=2)


def _of_frames(bench: Bench, reference: Seen) -> Array:
    """Derivatives (N, R, 6) by each pose's measurement frame, where each has its own."""
    rows_ = rows(bench.instrument, reference, reference).shape[1]
    if bench.instrument.frame != "pose":
        return np.zeros((len(bench.schedule.time), rows_, 0))
    return np.stack(_of_shift(bench, reference, lambda g: g >= 0), axis=2)


def _of_shift(bench: Bench, reference: Seen, chosen: Callable[[Array], Array]) -> list[Array]:
    """Derivatives (N, R) by six numbers of the base's place in the chosen measurement frames."""
    turned, moved = bench.instrument.base
    mask = chosen(np.arange(len(moved)))[:, None].astype(float)
    columns = []
    for part in STEP * np.eye(6):
        base = (turned @ rotation(mask * part[3:]), moved + mask * part[:3])
        changed = replace(bench, instrument=replace(bench.instrument, base=base)).exact()
        columns.append(_derivative(bench, reference, changed, FREE))
    return columns


def _of_base(bench: Bench, reference: Seen) -> list[Array]:
    instrument, columns = bench.instrument, []
    count = instrument.stations.size
    for part in np.eye(count).reshape(count, *instrument.stations.shape):
        moved = replace(instrument, stations=instrument.stations + STEP * part)
        columns.append(_derivative(bench, reference, replace(bench, instrument=moved).exact(), FREE))
    if instrument.kind == "distances":
        return columns
    if instrument.frame == "pose":
        return []
    for group in range(len(instrument.base[1])):
        columns += _of_shift(bench, reference, lambda g, own=group: g == own)
    return columns


def _of_places(bench: Bench, reference: Seen) -> list[Array]:
    instrument = bench.instrument
    columns = _of_tool(bench, reference) if instrument.kind == "poses" else []
    for number, target in enumerate(instrument.targets):
        for part in np.eye(3):
            moved = list(instrument.targets)
            moved[number] = replace(target, place=target.place + STEP * part)
            changed = replace(bench, instrument=replace(instrument, targets=tuple(moved))).exact()
            columns.append(_derivative(bench, reference, changed, instrument.noise if target.surveyed else FREE))
    return columns


def _of_tool(bench: Bench, reference: Seen) -> list[Array]:
    """Derivatives (N, R) by six numbers of the measured tool's place in its link."""
    columns = []
    for part in STEP * np.eye(6):
        moved = reference.moved + reference.turned @ part[:3]
        changed = replace(reference, turned=reference.turned @ rotation(part[3:]), moved=moved)
        columns.append(_derivative(bench, reference, changed, FREE))
    return columns


def _of_geometry(bench: Bench, reference: Seen) -> list[Array]:
    sigmas = bench.design.sigmas(bench.tolerance or UNDECLARED)
    return [
        _derivative(bench, reference, bench.exact(arm=bench.design.changed(STEP * part)), sigma)
        for part, sigma in zip(np.eye(len(sigmas)), sigmas, strict=True)
        if sigma > 0.0
    ]
