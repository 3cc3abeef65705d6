"""Readings and signals of a loaded sensor as a function of what is not known exactly, with exact derivatives.

Loads pass the chain wrench -> deflection -> readings. Every effect changes one field, in proportion to it or by what is
known of the steps: changes pass what comes downstream by the same linear maps. Load steps stand for poses and channels
for targets, of one dimension each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import Split
from truing.simulation.bench.causes.reading_causes import FIELDS, BenchScene, ReadingCause
from truing.simulation.bench.known_readings import KnownReadings, ReadingConditions
from truing.simulation.bench.load_steps import CHANNELS, IN_RUN, LINEAR, LOADS, LoadSteps, ReadingState
from truing.simulation.bench.six_upur.uncertain_sensor import Response
from truing.simulation.cause import Effect, Step
from truing.simulation.effects_model import ChannelModel, Prediction
from truing.simulation.inputs import ORDER, TIME, ranks
from truing.simulation.trace import Trace


@dataclass(frozen=True)
class BenchForwardPass(Trace[ReadingCause, ReadingState]):
    """How loads pass the chain: compliance (6, 6), rows (S, 6) of signals by wrench, and the view (6, 6) that channels
    have of the platform's motion."""

    compliance: NDArray
    rows: NDArray
    view: NDArray

    def from_wrench(self, slopes: NDArray, cause: ReadingCause | None = None) -> NDArray:
        """Return how readings (B, K, P) follow changes of the wrench (B, 6, P), upstream of all or after a cause."""
        for effect, state in self.subsequent_effects(cause, Step.DRIVE):
            slopes = effect.cause.passed_on(slopes, state, effect.values)
        signals = self.rows @ slopes
        if not self.subsequent_effects(None, Step.STRUCTURE):
            return self.from_motion(self.compliance @ slopes, signals)
        return self.from_deflection(self.compliance[..., None] * slopes[:, None], signals)

    def from_deflection(
        self, slopes: NDArray, signals: NDArray | None = None, cause: ReadingCause | None = None
    ) -> NDArray:
        """Return how readings (B, K, P) follow changes of the deflection (B, 6, 6, P), and of the signals (B, S, P)."""
        for effect, state in self.subsequent_effects(cause, Step.STRUCTURE):
            slopes = effect.cause.passed_on(slopes, state, effect.values)
        motion = slopes.sum(2)
        if signals is None:
            signals = np.zeros((len(motion), len(self.rows), motion.shape[-1]))
        return self.from_motion(motion, signals)

    def from_motion(self, slopes: NDArray, signals: NDArray) -> NDArray:
        """Return how readings (B, K, P) follow changes of the motion (B, 6, P), and of the signals (B, S, P)."""
        return self.from_readings(np.concatenate([self.view @ slopes, signals], 1))

    def from_readings(self, slopes: NDArray, cause: ReadingCause | None = None) -> NDArray:
        """Return what becomes of changes of the readings (B, K, P)."""
        for effect, state in self.subsequent_effects(cause, Step.INSTRUMENT):
            slopes = effect.cause.passed_on(slopes, state, effect.values)
        return slopes

    def of_cause(self, cause: ReadingCause, values: NDArray) -> NDArray:
        """Return how readings (B, K, P) follow a cause's parameters; its own field is all that it changes."""
        slopes = cause.slopes(self.at(cause), values)
        if cause.step is Step.DRIVE:
            return self.from_wrench(slopes, cause)
        if cause.step is Step.STRUCTURE:
            return self.from_deflection(slopes, None, cause)
        return self.from_readings(slopes, cause)


def passed(
    steps: LoadSteps,
    wrench: NDArray,
    compliance: NDArray,
    rows: NDArray,
    seen: tuple[NDArray, NDArray],
    effects: Sequence[Effect[ReadingCause]],
) -> BenchForwardPass:
    """Return how wrenches (B, 6) pass the chain with a compliance (6, 6), rows of signals by wrench (S, 6), effects.

    seen: how channels follow the motion (6, 6), and what they read beside it (B, 6).
    """
    count = len(wrench)
    start = ReadingState(steps, wrench, np.zeros((count, len(compliance), 0)), np.zeros((count, 0)))
    driven = BenchForwardPass(start, (), {}, compliance, rows, seen[0]).through(Step.DRIVE, effects, _applied)
    bent = replace(driven.state, deflection=compliance * driven.state.wrench[:, None])
    built = driven.entering(bent).through(Step.STRUCTURE, effects, _applied)
    state = built.state
    motion = state.deflection.sum(-1) @ seen[0].T + seen[1]
    read = replace(state, readings=np.concatenate([motion, state.wrench @ rows.T], 1))
    return built.entering(read).through(Step.INSTRUMENT, effects, _applied)


def _applied(effect: Effect[ReadingCause], state: ReadingState) -> ReadingState:
    name = FIELDS[effect.cause.step]
    return replace(state, **{name: getattr(state, name) + effect.cause.moved(state, effect.values)})


_AXES = 6
# Beforehand either model of what a leg carries may hold, and anything between them: at the middle, give or take one.
_BETWEEN = 0.5


@dataclass(frozen=True)
class BenchModel(ChannelModel[ReadingCause]):
    """A sensor on its bench with K channels; a function of the unknowns for a set of effects."""

    known: KnownReadings
    conditions: ReadingConditions

    @property
    def part_count(self) -> int:
        """Return the number of legs, whose stiffnesses some causes follow."""
        return _AXES

    @property
    def _sizes(self) -> dict[str, int]:
        sensor = self.known.sensor
        sizes = {"zero": len(self.known.zeros.run)}
        sizes |= {"geometry": sensor.geometry_size, "stiffness": sensor.stiffness_size}
        sizes |= {"gain": self.known.gains.start.size, "legforce": int(self._has_two_models)}
        return sizes | {"optics": self.known.optics.size}

    @cached_property
    def _noisy(self) -> NDArray:
        """Return the axes whose loads have errors."""
        return np.flatnonzero(self.known.load_sigma > 0.0)

    @property
    def local_size(self) -> int:
        """Return the number of local unknowns: the load errors of a step."""
        return len(self._noisy)

    @property
    def channel_groups(self) -> NDArray:
        """Return the number of each channel's noise (K,): one for displacements, rotations and signals each.

        A single channel has too few readings to tell its noise from an effect on most of them.
        """
        return np.minimum(np.arange(len(self.known.channels)) // LINEAR, len(CHANNELS) // LINEAR)

    channel_word = "channel"

    @property
    def channel_names(self) -> tuple[str, ...]:
        """The names (K,) of the channels."""
        return self.known.channels

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """Which of them (K,) are signals."""
        return tuple("signal" if n >= len(CHANNELS) else "channel" for n in range(len(self.known.channels)))

    @cached_property
    def zero_groups(self) -> NDArray:
        """Return the number (B, K) of the run and channel whose zero a reading counts from; -1 for tared signals."""
        count, own = len(self.known.channels), self.known.zeros
        tared = np.isin(np.arange(count), own.channel[own.known & (own.channel >= len(CHANNELS))])
        return np.where(tared, -1, self.steps.code[:, None] * count + np.arange(count))

    @property
    def error_groups(self) -> NDArray:
        """Return the numbers of the runs (B,), whose steps err together."""
        return self.steps.code

    @property
    def blocks(self) -> NDArray:
        """Return which steps (B,) are left out of a fit together."""
        return run_blocks(self.steps)

    @cached_property
    def steps(self) -> LoadSteps:
        """Return the load steps, with what the plain simulation expects at them."""
        known, own = self.known, self.conditions
        order = ranks(own.time_s).astype(float)
        sensor, shared = known.sensor, np.zeros(self.shared_size)
        response = self._response(shared)
        bare = LoadSteps(
            own.run, own.step, own.time_s, own.load, known.largest, own.covariates, known.channels, known.sigma,
            own.load @ response.compliance.T, own.load @ self._rows(shared, response).T, known.wavelength_m,
            sensor.legs,
        )  # fmt: skip
        loads = {name: own.load[:, n] for n, name in enumerate(LOADS) if bare.loaded[n]}
        columns = {**own.covariates, TIME: own.time_s, IN_RUN: bare.in_run_s, ORDER: order, **loads}
        return replace(bare, covariates=columns)

    @property
    def split(self) -> Split | None:
        """Return how elastic parameters split into what is common to all legs and each leg's own."""
        own = self.known.sensor
        common = np.array([leg is None for leg, _ in own.unknowns[own.geometry_size :]])
        return Split(np.r_[self.layout["stiffness"]], common, own.share) if own.is_split else None

    def with_share(self, share: float) -> Self:
        """Return the model with another share of the elastic parameters' variance in common."""
        return replace(self, known=replace(self.known, sensor=replace(self.known.sensor, share=share)))

    @property
    def scene(self) -> BenchScene:
        """Return what the campaign offers to causes when they propose candidates."""
        return BenchScene(self.steps)

    def with_causes(self, causes: Sequence[ReadingCause]) -> Self:
        """Return the model with these effects among its unknowns, and those that a prior campaign found."""
        return self._of_same_steps(super().with_causes(causes))

    def _of_same_steps(self, model: Self) -> Self:
        """Return another model of the same load steps, which keeps what was computed of them."""
        model.__dict__["steps"] = self.steps
        return model

    def at(self, conditions: ReadingConditions) -> Self:
        """Return the model at other load steps; runs that it does not know have no zero."""
        return replace(self, conditions=conditions)

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model with the noise of loads so many times as large; there is no survey."""
        rescaled = replace(self, known=replace(self.known, load_sigma=self.known.load_sigma * readings))
        return self._of_same_steps(rescaled)

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted readings (B, K, 1), SI, at shared (G,) and local (B, H) unknowns."""
        return self._with_zeros(self._forward_pass(shared, local).state.readings, shared)[..., None]

    def wrenches(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the wrenches (B, 6) that truly act, N and N m, at shared (G,) and local (B, H) unknowns."""
        return self._forward_pass(shared, local).state.wrench

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return readings and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones if asked for."""
        forward_pass = self._forward_pass(shared, local)
        points = self._with_zeros(forward_pass.state.readings, shared)[..., None]
        slopes = self._by_shared(shared, forward_pass)[:, :, None] if by_shared else None
        return self._prediction(shared, points, slopes, forward_pass.from_wrench(self._load_errors)[:, :, None])

    def _slopes_at(self, shared: NDArray, local: NDArray) -> Callable[[ReadingCause, NDArray], NDArray]:
        return self._forward_pass(shared, local).of_cause

    @property
    def _has_two_models(self) -> bool:
        return self.known.gains.are_of_legs and self.known.signals > 0 and self.known.sensor.models > 1

    @property
    def _shared_known(self) -> NDArray:
        known = np.zeros(self.shared_size, bool)
        known[self.layout["zero"]] = self.known.zeros.known
        known[self.layout["geometry"]] = known[self.layout["stiffness"]] = True
        known[self.layout["gain"]] = self.known.gains.known
        known[self.layout["optics"]] = True
        return known

    @cached_property
    def _load_errors(self) -> NDArray:
        """Return how wrenches (B, 6, H) follow the load errors of a step: of the axes that it loads."""
        load = self.conditions.load
        errors = np.zeros((*load.shape, self.local_size))
        for place, axis in enumerate(self._noisy):
            errors[:, axis, place] = self.known.load_sigma[axis] * (load[:, axis] != 0.0)
        return errors

    @cached_property
    def _zero_of(self) -> NDArray:
        return self.known.zeros.at(self.conditions.run, len(self.known.channels))

    def _with_zeros(self, readings: NDArray, shared: NDArray) -> NDArray:
        zeros = np.append(shared[self.layout["zero"]] * self.known.zeros.sigma, 0.0)
        return np.asarray(readings + zeros[self._zero_of])

    def _response(self, shared: NDArray) -> Response:
        return self.known.sensor.at(shared[self.layout["geometry"]], shared[self.layout["stiffness"]])

    def _gains(self, shared: NDArray) -> NDArray:
        own = self.known.gains
        return own.start + own.sigma * shared[self.layout["gain"]].reshape(own.start.shape)

    def _mixed(self, forces: NDArray, shared: NDArray) -> NDArray:
        """Return the leg forces (..., 6, 6) between the two models of them (..., M, 6, 6)."""
        if not self._has_two_models:
            return forces[..., 0, :, :]
        share = _BETWEEN + shared[self.layout["legforce"]][0]
        return np.asarray((1.0 - share) * forces[..., 0, :, :] + share * forces[..., 1, :, :])

    def _rows(self, shared: NDArray, response: Response) -> NDArray:
        """Return how signals follow the wrench (S, 6)."""
        gains = self._gains(shared)
        if not self.known.gains.are_of_legs:
            return gains
        return gains[:, None] * self._mixed(response.forces, shared) if len(gains) else np.zeros((0, _AXES))

    def _forward_pass(self, shared: NDArray, local: NDArray) -> BenchForwardPass:
        """Return how the loads pass the chain with the effects in force."""
        response = self._response(shared)
        rows = self._rows(shared, response)
        wrench = self.conditions.load + np.einsum("bkh,bh->bk", self._load_errors, local)
        unknowns, optics = shared[self.layout["optics"]], self.known.optics
        seen = optics.rows_at(unknowns), optics.grown(self.steps, unknowns)
        return passed(self.steps, wrench, response.compliance, rows, seen, self.effects(shared))

    def _by_shared(self, shared: NDArray, forward_pass: BenchForwardPass) -> NDArray:
        """Return the readings' derivatives (B, K, G) by the shared unknowns."""
        slopes = np.zeros((*forward_pass.state.readings.shape, self.shared_size))
        index = self._zero_of
        step, channel = np.nonzero(index >= 0)
        slopes[step, channel, self.layout["zero"].start + index[step, channel]] = self.known.zeros.sigma[
            index[step, channel]
        ]
        sensor, wrench = self.known.sensor, forward_pass.after[Step.DRIVE].wrench
        by_stiffness = sensor.by_stiffness(shared[self.layout["stiffness"]])
        for name, response in (("geometry", sensor.by_geometry), ("stiffness", by_stiffness)):
            if len(response.compliance):
                slopes[..., self.layout[name]] = self._by_response(response, shared, wrench, forward_pass)
        for name, by_wrench in self._by_signals(shared).items():
            signals = np.einsum("sjn,bj->bsn", by_wrench, wrench)
            motion = np.zeros((len(wrench), _AXES, signals.shape[-1]))
            slopes[..., self.layout[name]] = forward_pass.from_readings(np.concatenate([motion, signals], 1))
        if self.known.optics.size:
            motion = forward_pass.after[Step.STRUCTURE].deflection.sum(-1)
            seen = self.known.optics.slopes(self.steps, motion)
            still = np.zeros((len(wrench), self.known.signals, self.known.optics.size))
            slopes[..., self.layout["optics"]] = forward_pass.from_readings(np.concatenate([seen, still], 1))
        self._fill_effects(slopes, shared, forward_pass.of_cause)
        return slopes

    def _by_response(
        self, response: Response, shared: NDArray, wrench: NDArray, forward_pass: BenchForwardPass
    ) -> NDArray:
        """Return the readings' derivatives (B, K, n) by what changes the sensor's response."""
        signals = np.zeros((len(wrench), self.known.signals, len(response.compliance)))
        if self.known.signals and self.known.gains.are_of_legs:
            rows = self._gains(shared)[:, None] * self._mixed(response.forces, shared)
            signals = np.einsum("nsj,bj->bsn", rows, wrench)
        if not forward_pass.subsequent_effects(None, Step.STRUCTURE):
            motion = np.moveaxis(wrench @ np.swapaxes(response.compliance, -1, -2), 0, -1)
            return forward_pass.from_motion(motion, signals)
        deflection = np.moveaxis(response.compliance, 0, -1) * wrench[:, None, :, None]
        return forward_pass.from_deflection(deflection, signals)

    def _by_signals(self, shared: NDArray) -> dict[str, NDArray]:
        """Return how the signals' rows follow gains and what lies between the models of leg forces: (S, 6, n) each."""
        own = self.known.gains
        if not self.known.signals:
            return {}
        if not own.are_of_legs:
            count = own.start.size
            return {"gain": np.eye(count).reshape(*own.start.shape, count) * own.sigma.ravel()}
        forces = self._response(shared).forces
        each = np.eye(self.known.signals) * own.sigma
        found = {"gain": self._mixed(forces, shared)[..., None] * each[:, None]}
        if self._has_two_models:
            apart = forces[1] - forces[0]
            found["legforce"] = (self._gains(shared)[:, None] * apart)[..., None]
        return found


_BLOCKS = 5  # of what is left out in turn


def run_blocks(steps: LoadSteps) -> NDArray:
    """Return a number for each step (B,): whole runs, one of each that loads the same axes; parts of a run where no
    other loads its axes."""
    axes = (steps.load != 0.0) @ (1 << np.arange(len(LOADS)))
    pattern = np.zeros(int(steps.code.max(initial=-1)) + 1, int)
    np.bitwise_or.at(pattern, steps.code, axes)
    alike = pattern[:, None] == pattern
    # Runs that load the same axes may each read another channel: not one channel's runs are left out all at once.
    of_axes = np.unique(pattern, return_inverse=True)[1]
    of_run = (np.tril(alike, -1).sum(1) + of_axes) % _BLOCKS
    length = np.bincount(steps.code)
    within = steps.rank * _BLOCKS // np.maximum(length, 1)[steps.code]
    return np.where(alike.sum(1)[steps.code] > 1, of_run[steps.code], within)
