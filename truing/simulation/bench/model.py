"""Class `BenchModel`: readings and signals of a loaded sensor as a function of the unknowns, with exact derivatives.

Loads pass through the chain wrench -> deflection -> readings. Every effect changes one field, proportionally or by
known data of the steps, so that changes propagate through subsequent effects by the same linear maps. Load steps take
the place of poses, and channels of dimension one that of targets.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import PartialDesign, Split, ZeroColumns
from truing.simulation.bench.causes.reading_causes import FIELDS, BenchScene, ReadingCause
from truing.simulation.bench.known_readings import KnownReadings, ReadingConditions
from truing.simulation.bench.load_steps import CHANNELS, IN_RUN, LINEAR, LOADS, LoadSteps, ReadingState
from truing.simulation.bench.six_upur.uncertain_sensor import Response
from truing.simulation.cause import OBSERVED, Effect, Step
from truing.simulation.effects_model import ChannelModel, Prediction
from truing.simulation.inputs import ORDER, TIME, ranks
from truing.simulation.trace import Trace


@dataclass(frozen=True)
class BenchForwardPass(Trace[ReadingCause, ReadingState]):
    """Forward pass of loads: compliance (6, 6), rows (S, 6) of signals by wrench, and view (6, 6) of channels by
    motion."""

    compliance: NDArray
    rows: NDArray
    view: NDArray

    def from_wrench(self, slopes: NDArray, cause: ReadingCause | None = None) -> NDArray:
        """Return the changes of readings (B, K, P) by changes of the wrench (B, 6, P), before all effects or after a
        cause."""
        for effect, state in self.subsequent_effects(cause, Step.DRIVE):
            slopes = effect.cause.passed_on(slopes, state, effect.values)
        signals = self.rows @ slopes
        if not self.subsequent_effects(None, Step.STRUCTURE):
            return self.from_motion(self.compliance @ slopes, signals)
        return self.from_deflection(self.compliance[..., None] * slopes[:, None], signals)

    def from_deflection(
        self, slopes: NDArray, signals: NDArray | None = None, cause: ReadingCause | None = None
    ) -> NDArray:
        """Return the changes of readings (B, K, P) by changes of deflection (B, 6, 6, P) and signals (B, S, P)."""
        for effect, state in self.subsequent_effects(cause, Step.STRUCTURE):
            slopes = effect.cause.passed_on(slopes, state, effect.values)
        motion = slopes.sum(2)
        if signals is None:
            signals = np.zeros((len(motion), len(self.rows), motion.shape[-1]))
        return self.from_motion(motion, signals)

    def bent(self, wrench: NDArray) -> NDArray:
        """Return the derivatives of the motion (B, 6, 36) by the entries of the compliance, after the effects on the
        deflection. These are linear in it and act on the response to each load separately. So unit responses pass
        through them once, however many parameters the compliance has."""
        unit = np.eye(_AXES)[:, None] * wrench[:, None, :, None]
        for effect, state in self.subsequent_effects(None, Step.STRUCTURE):
            unit = effect.cause.passed_on(unit, state, effect.values)
        return np.swapaxes(unit, 2, 3).reshape(len(wrench), _AXES, -1)

    def from_motion(self, slopes: NDArray, signals: NDArray) -> NDArray:
        """Return the changes of readings (B, K, P) by changes of motion (B, 6, P) and signals (B, S, P)."""
        return self.from_readings(np.concatenate([self.view @ slopes, signals], 1))

    def from_readings(self, slopes: NDArray, cause: ReadingCause | None = None) -> NDArray:
        """Return changes of the readings (B, K, P) after the effects of the instrument."""
        for effect, state in self.subsequent_effects(cause, Step.INSTRUMENT):
            slopes = effect.cause.passed_on(slopes, state, effect.values)
        return slopes

    def of_cause(self, cause: ReadingCause, values: NDArray) -> NDArray:
        """Return the derivatives of readings (B, K, P) by a cause's parameters, through the field that it changes."""
        slopes = cause.slopes(self.at(cause), values)
        if cause.step is Step.DRIVE:
            return self.from_wrench(slopes, cause)
        if cause.step is Step.STRUCTURE:
            return self.from_deflection(slopes, None, cause)
        return self.from_readings(slopes, cause)


def pass_through(
    steps: LoadSteps,
    wrench: NDArray,
    compliance: NDArray,
    rows: NDArray,
    seen: tuple[NDArray, NDArray],
    effects: Sequence[Effect[ReadingCause]],
) -> BenchForwardPass:
    """Pass wrenches (B, 6) through the chain with a compliance (6, 6), rows of signals by wrench (S, 6) and effects.

    seen: rows (6, 6) of channels by motion, and their additional readings (B, 6).
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
# Prior of the mixture of the two models of leg forces: the middle, with a sigma of one.
_BETWEEN = 0.5


@dataclass(frozen=True)
class BenchModel(ChannelModel[ReadingCause]):
    """A sensor on its bench with K channels, as a function of the unknowns for a set of effects."""

    known: KnownReadings
    conditions: ReadingConditions

    @property
    def part_count(self) -> int:
        """Number of legs, whose stiffnesses some causes change."""
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
        """Axes whose loads have errors."""
        return np.flatnonzero(self.known.load_sigma > 0.0)

    @property
    def local_size(self) -> int:
        """Number of local unknowns: the load errors of a step."""
        return len(self._noisy)

    @property
    def channel_groups(self) -> NDArray:
        """Noise group (K,) of each channel: displacements, rotations and signals.

        A single channel has too few readings to distinguish its noise from an effect on most of them.
        """
        return np.minimum(np.arange(len(self.known.channels)) // LINEAR, len(CHANNELS) // LINEAR)

    channel_word = "channel"

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names (K,) of the channels."""
        return self.known.channels

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """Sort (K,) of each channel: ``channel`` or ``signal``."""
        return tuple("signal" if n >= len(CHANNELS) else "channel" for n in range(len(self.known.channels)))

    @cached_property
    def zero_groups(self) -> NDArray:
        """Number (B, K) of the run and channel whose zero a reading has; -1 for tared signals."""
        count, zeros = len(self.known.channels), self.known.zeros
        tared = np.isin(np.arange(count), zeros.channel[zeros.known & (zeros.channel >= len(CHANNELS))])
        return np.where(tared, -1, self.steps.code[:, None] * count + np.arange(count))

    @property
    def error_groups(self) -> NDArray:
        """Number of the run (B,) of each step: steps of a run have common errors."""
        return self.steps.code

    @property
    def blocks(self) -> NDArray:
        """Block (B,) of each step: steps of one block are left out of a fit together."""
        return run_blocks(self.steps)

    @cached_property
    def steps(self) -> LoadSteps:
        """Load steps, with the predictions of the plain simulation."""
        known, conditions = self.known, self.conditions
        order = ranks(conditions.time_s).astype(float) if conditions.is_timed else np.arange(len(conditions.run)) * 1.0
        sensor, shared = known.sensor, np.zeros(self.shared_size)
        response = self._response(shared)
        bare = LoadSteps(
            conditions.run,
            conditions.step,
            conditions.time_s,
            conditions.load,
            known.largest,
            conditions.covariates,
            known.channels,
            known.sigma,
            conditions.load @ response.compliance.T,
            conditions.load @ self._rows(shared, response).T,
            known.wavelength_m,
            sensor.legs,
            known.arms,
        )
        loads = {name: conditions.load[:, n] for n, name in enumerate(LOADS) if bare.loaded[n]}
        timed = {TIME: conditions.time_s, IN_RUN: bare.in_run_s} if conditions.is_timed else {}
        return replace(bare, covariates={**conditions.covariates, **timed, ORDER: order, **loads})

    @property
    def split(self) -> Split | None:
        """Elastic parameters, split into a part common to all legs and one per leg."""
        sensor = self.known.sensor
        common = np.array([leg is None for leg, _ in sensor.unknowns[sensor.geometry_size :]])
        return Split(np.r_[self.layout["stiffness"]], common, sensor.share) if sensor.is_split else None

    def with_share(self, share: float) -> Self:
        """Return the model with another common share of the elastic parameters' variance."""
        return replace(self, known=replace(self.known, sensor=replace(self.known.sensor, share=share)))

    @property
    def scene(self) -> BenchScene:
        """Scene from which causes propose candidates."""
        return BenchScene(self.steps)

    def with_causes(self, causes: Sequence[ReadingCause]) -> Self:
        """Return the model with the effects of these causes, and those of the prior campaign, among its unknowns."""
        return self._with_cached_steps(super().with_causes(causes))

    def _with_cached_steps(self, model: Self) -> Self:
        """Return another model of the same load steps, with their cached results."""
        model.__dict__["steps"] = self.steps
        return model

    def at(self, conditions: ReadingConditions) -> Self:
        """Return the model at other load steps; runs that it does not know have no zero."""
        return replace(self, conditions=conditions)

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model with the noise of loads multiplied by a factor; there is no survey."""
        rescaled = replace(self, known=replace(self.known, load_sigma=self.known.load_sigma * readings))
        return self._with_cached_steps(rescaled)

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted readings (B, K, 1), SI, at shared (G,) and local (B, H) unknowns."""
        return self._with_zeros(self._forward_pass(shared, local).state.readings, shared)[..., None]

    def wrenches(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the true wrenches (B, 6), N and N m, at shared (G,) and local (B, H) unknowns."""
        return self._forward_pass(shared, local).state.wrench

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return readings and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones on request."""
        forward_pass = self._forward_pass(shared, local)
        points = self._with_zeros(forward_pass.state.readings, shared)[..., None]
        slopes = self._by_shared(shared, forward_pass)[:, :, None] if by_shared else None
        prediction = self._prediction(shared, points, slopes, forward_pass.from_wrench(self._load_errors)[:, :, None])
        return replace(prediction, zero_columns=self._zero_columns) if by_shared else prediction

    def partial_designs(
        self, shared: NDArray, local: NDArray
    ) -> Callable[[ReadingCause], Mapping[str, NDArray | PartialDesign]]:
        """Return the function from a candidate to its design; one that the load steps determine holds its channels
        only."""
        designs, steps = self.design_matrix(shared, local), self.steps

        def found(cause: ReadingCause) -> Mapping[str, NDArray | PartialDesign]:
            derivative = None if cause.key in self.layout else cause.channel_slopes(steps)
            if derivative is None:
                return designs(cause)
            channels, along = np.flatnonzero(derivative[0]), derivative[1] * self.effect_scale(cause)
            return {OBSERVED: PartialDesign(channels, np.repeat(along[:, None], len(channels), 1))}

        return found

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
        """Derivatives (B, 6, H) of wrenches by the load errors of a step, on the axes that it loads."""
        load = self.conditions.load
        errors = np.zeros((*load.shape, self.local_size))
        for index, axis in enumerate(self._noisy):
            errors[:, axis, index] = self.known.load_sigma[axis] * (load[:, axis] != 0.0)
        return errors

    @cached_property
    def _zero_of(self) -> NDArray:
        return self.known.zeros.at(self.conditions.run, len(self.known.channels))

    @cached_property
    def _zero_columns(self) -> ZeroColumns:
        """Derivatives of the readings by zeros, which come first among the shared unknowns."""
        slope = np.append(self.known.zeros.sigma, 0.0)[self._zero_of]
        return ZeroColumns(len(self.known.zeros.run), self._zero_of, slope)

    def _with_zeros(self, readings: NDArray, shared: NDArray) -> NDArray:
        zeros = np.append(shared[self.layout["zero"]] * self.known.zeros.sigma, 0.0)
        return np.asarray(readings + zeros[self._zero_of])

    def _response(self, shared: NDArray) -> Response:
        return self.known.sensor.at(shared[self.layout["geometry"]], shared[self.layout["stiffness"]])

    def _gains(self, shared: NDArray) -> NDArray:
        gains = self.known.gains
        return gains.start + gains.sigma * shared[self.layout["gain"]].reshape(gains.start.shape)

    def _mixed(self, forces: NDArray, shared: NDArray) -> NDArray:
        """Return the leg forces (..., 6, 6) between their two models (..., M, 6, 6)."""
        if not self._has_two_models:
            return forces[..., 0, :, :]
        share = _BETWEEN + shared[self.layout["legforce"]][0]
        return np.asarray((1.0 - share) * forces[..., 0, :, :] + share * forces[..., 1, :, :])

    def _rows(self, shared: NDArray, response: Response) -> NDArray:
        """Return the derivatives (S, 6) of signals by the wrench."""
        gains = self._gains(shared)
        if not self.known.gains.are_of_legs:
            return gains
        return gains[:, None] * self._mixed(response.forces, shared) if len(gains) else np.zeros((0, _AXES))

    def _forward_pass(self, shared: NDArray, local: NDArray) -> BenchForwardPass:
        """Pass the loads through the chain with the effects in force."""
        response = self._response(shared)
        rows = self._rows(shared, response)
        wrench = self.conditions.load + np.einsum("bkh,bh->bk", self._load_errors, local)
        unknowns, optics = shared[self.layout["optics"]], self.known.optics
        seen = optics.rows_at(unknowns), optics.grown(self.steps, unknowns)
        return pass_through(self.steps, wrench, response.compliance, rows, seen, self.effects(shared))

    def _by_shared(self, shared: NDArray, forward_pass: BenchForwardPass) -> NDArray:
        """Return the readings' derivatives (B, K, G - Z) by the shared unknowns after the zeros."""
        first = self.layout["zero"].stop
        layout = {name: slice(part.start - first, part.stop - first) for name, part in self.layout.items()}
        slopes = np.zeros((*forward_pass.state.readings.shape, self.shared_size - first))
        sensor, wrench = self.known.sensor, forward_pass.after[Step.DRIVE].wrench
        by_stiffness = sensor.by_stiffness(shared[self.layout["stiffness"]])
        for name, response in (("geometry", sensor.by_geometry), ("stiffness", by_stiffness)):
            if len(response.compliance):
                slopes[..., layout[name]] = self._by_response(response, shared, wrench, forward_pass)
        for name, by_wrench in self._by_signals(shared).items():
            signals = np.einsum("sjn,bj->bsn", by_wrench, wrench)
            motion = np.zeros((len(wrench), _AXES, signals.shape[-1]))
            slopes[..., layout[name]] = forward_pass.from_readings(np.concatenate([motion, signals], 1))
        if self.known.optics.size:
            motion = forward_pass.after[Step.STRUCTURE].deflection.sum(-1)
            seen = self.known.optics.slopes(self.steps, motion)
            zero_columns = np.zeros((len(wrench), self.known.signals, self.known.optics.size))
            slopes[..., layout["optics"]] = forward_pass.from_readings(np.concatenate([seen, zero_columns], 1))
        self._fill_effects(slopes, shared, forward_pass.of_cause, first)
        return slopes

    def _by_response(
        self, response: Response, shared: NDArray, wrench: NDArray, forward_pass: BenchForwardPass
    ) -> NDArray:
        """Return the readings' derivatives (B, K, n) by changes of the sensor's response."""
        signals = np.zeros((len(wrench), self.known.signals, len(response.compliance)))
        if self.known.signals and self.known.gains.are_of_legs:
            rows = self._gains(shared)[:, None] * self._mixed(response.forces, shared)
            signals = np.einsum("nsj,bj->bsn", rows, wrench)
        if not forward_pass.subsequent_effects(None, Step.STRUCTURE):
            motion = np.moveaxis(wrench @ np.swapaxes(response.compliance, -1, -2), 0, -1)
            return forward_pass.from_motion(motion, signals)
        return forward_pass.from_motion(forward_pass.bent(wrench) @ response.compliance.reshape(-1, 36).T, signals)

    def _by_signals(self, shared: NDArray) -> dict[str, NDArray]:
        """Return the derivatives (S, 6, n) of the signals' rows by gains, and by the mixture of the models of leg
        forces."""
        gains = self.known.gains
        if not self.known.signals:
            return {}
        if not gains.are_of_legs:
            count = gains.start.size
            return {"gain": np.eye(count).reshape(*gains.start.shape, count) * gains.sigma.ravel()}
        forces = self._response(shared).forces
        each = np.eye(self.known.signals) * gains.sigma
        parts = {"gain": self._mixed(forces, shared)[..., None] * each[:, None]}
        if self._has_two_models:
            force_difference = forces[1] - forces[0]
            parts["legforce"] = (self._gains(shared)[:, None] * force_difference)[..., None]
        return parts


_BLOCKS = 5  # number of blocks that are left out in turn


def run_blocks(steps: LoadSteps) -> NDArray:
    """Return the block (B,) of each step, for leaving out data in blocks.

    Runs that load the same axes go to different blocks; a run whose axes no other run loads is cut into parts.
    """
    axes = (steps.load != 0.0) @ (1 << np.arange(len(LOADS)))
    pattern = np.zeros(int(steps.code.max(initial=-1)) + 1, int)
    np.bitwise_or.at(pattern, steps.code, axes)
    alike = pattern[:, None] == pattern
    # Runs of the same axes may read different channels: no block has all runs of a channel.
    of_axes = np.unique(pattern, return_inverse=True)[1]
    of_run = (np.tril(alike, -1).sum(1) + of_axes) % _BLOCKS
    length = np.bincount(steps.code)
    within = steps.rank * _BLOCKS // np.maximum(length, 1)[steps.code]
    return np.where(alike.sum(1)[steps.code] > 1, of_run[steps.code], within)
