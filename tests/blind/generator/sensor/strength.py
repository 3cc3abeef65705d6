"""Strength of an effect in a campaign: root of its non-centrality after a fit of all unknowns.

What is not known: the zero of each run and channel, lengths and elastic parameters of the legs, gain and offset of each
signal, and the loads where they are noisy. All derivatives are differences of the generator's own machine; whatever is
held out counts for nothing, as in a fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.campaign import SIXTH, Campaign, bridges
from tests.blind.generator.sensor.layout import Tolerance
from tests.blind.generator.sensor.machine import LEGS, Errors, Machine, build, sharing

STEP = 1e-6  # m, and of the logarithm of a compliance
FREE_GAIN, FREE_OFFSET = 10.0, 1e4  # priors of what nothing is known of: a share of the gain, sigmas of a signal
LEVEL = 0.1  # how well the declared noise is known
LENGTHS = ("platform_radius", "base_radius", "lower_clearance", "middle_clearance", "sensor_installation")


@dataclass(frozen=True)
class Fit:
    """A fit of the plain bench to R rows: ``weight`` (R,) is one over the noise, 0 for what is not fitted; ``columns``
    (R, U) what the unknowns do, weighed and to the scale of their priors; ``inverse`` (U, U) their covariance.
    """

    weight: Array
    columns: Array
    inverse: Array

    def strength(self, change: Array) -> float:
        """Root of the non-centrality of one change (R,) of what is measured."""
        seen = change * self.weight
        taken = seen @ self.columns
        return float(np.sqrt(max(seen @ seen - taken @ self.inverse @ taken, 0.0)))


def rows_of(campaign: Campaign) -> Array:
    """All that is measured (R,): readings before signals, by step."""
    return np.concatenate([campaign.readings.ravel(), campaign.signals.ravel()])


def fit_of(campaign: Campaign) -> Fit:
    """The fit to a campaign in which nothing is hidden."""
    weight = _weight(campaign)
    parts = [_zeros(campaign), _machine(campaign), _signals(campaign), _loads(campaign)]
    columns = np.concatenate([part for part in parts if part.shape[1]], axis=1) * weight[:, None]
    columns = columns[:, np.any(columns, axis=0)]
    return Fit(weight, columns, np.linalg.inv(np.eye(columns.shape[1]) + columns.T @ columns))


def fitted(campaign: Campaign) -> Array:
    """Mask of the readings (S, 6) that a fit may use."""
    held = np.array(campaign.schedule.role) == "verification"
    return campaign.is_observed & ~campaign.gross & ~held[:, None]


def strength_of_noise(campaign: Campaign, scatter: Array) -> float:
    """The same of noise that is ``scatter`` (S, 6) times the instrument's: a number of n tells its logarithm to
    1 / sqrt(2 n), and the level of all is known to some per cent only.
    """
    logs = np.log(scatter)[fitted(campaign)]
    level = 2 * logs.sum()
    return float(np.sqrt(2 * np.sum(logs**2) - level**2 / (2 * len(logs) + LEVEL**-2)))


def _weight(campaign: Campaign) -> Array:
    noise = campaign.layout.noise
    held = np.array(campaign.schedule.role) == "verification"
    readings = fitted(campaign) / noise.channels
    signals = np.where(held[:, None], 0.0, np.ones(campaign.signals.shape) / noise.signal_mv)
    return np.concatenate([readings.ravel(), signals.ravel()])


def _flat(campaign: Campaign, readings: Array, signals: Array | None = None) -> Array:
    """Columns (R, U) from those of the readings (S, 6, U) and of the signals (S, C, U)."""
    count = readings.shape[-1]
    if signals is None:
        signals = np.zeros((*campaign.signals.shape, count))
    return np.concatenate([part.reshape(part.shape[0] * part.shape[1], count) for part in (readings, signals)])


def _zeros(campaign: Campaign) -> Array:
    """One per run and channel, to the noise of a reading."""
    runs = campaign.schedule.run[:, None] == np.unique(campaign.schedule.run)
    each = runs[:, None, :, None] * (campaign.layout.noise.channels[:, None] * np.eye(6))[None, :, None, :]
    return _flat(campaign, each.reshape(len(runs), 6, -1))


def _machine(campaign: Campaign) -> Array:
    """Lengths of each leg and elastic parameters, of all legs and of each; a compliance that was given, as a whole."""
    layout, errors = campaign.layout, campaign.truth.errors
    known = layout.tolerance
    if layout.compliance_given:
        whole = known.stiffness * campaign.truth.machine.compliance
        return _flat(campaign, (campaign.schedule.load @ whole.T)[..., None])
    base, off = campaign.truth.machine, []
    for name in LENGTHS:
        sigma = SIXTH * getattr(known, name)
        off += [(build(layout.sensor, _longer(errors, name, leg)), sigma) for leg in range(LEGS)]
    if known.stiffness:
        off += _softer(base, errors.softer, known)
    return np.concatenate([_by_machine(campaign, one, base, sigma / STEP) for one, sigma in off], axis=1)


def _longer(errors: Errors, name: str, leg: int) -> Errors:
    return replace(errors, **{name: getattr(errors, name) + STEP * np.eye(LEGS)[leg]})


def _softer(base: Machine, softer: Array, known: Tolerance) -> list[tuple[Machine, float]]:
    """Machines with one part softer, in all legs and in each, and how far that may be off."""
    out, legs, parts = [], np.eye(LEGS), np.eye(softer.shape[1])
    for part in parts:
        for concerned, share in [(np.ones(LEGS), known.common), *((leg, 1 - known.common) for leg in legs)]:
            off = sharing(base.legs, softer * np.exp(STEP * np.outer(concerned, part)))
            out.append((off, known.stiffness * float(np.sqrt(share))))
    return out


def _by_machine(campaign: Campaign, off: Machine, base: Machine, scale: float) -> Array:
    load, gain = campaign.truth.load, campaign.truth.gain[:, 0]
    readings = load @ (off.compliance - base.compliance).T * scale
    signals = gain * (load @ (off.tension - base.tension).T)[:, bridges(campaign.layout)] * scale
    return _flat(campaign, readings[..., None], signals[..., None])


def _signals(campaign: Campaign) -> Array:
    """Gain and offset of each, of which nothing is known."""
    count = campaign.layout.signals
    tension = (campaign.truth.load @ campaign.truth.machine.tension.T)[:, bridges(campaign.layout)]
    by_gain = FREE_GAIN * (campaign.truth.gain[:, 0] * tension)[..., None] * np.eye(count)
    by_offset = np.broadcast_to(FREE_OFFSET * campaign.layout.noise.signal_mv * np.eye(count), by_gain.shape)
    signals = np.concatenate([by_gain, by_offset], axis=-1)
    return _flat(campaign, np.zeros((len(tension), 6, 2 * count)), signals)


def _loads(campaign: Campaign) -> Array:
    """The load of each step along each axis that is loaded, where it is noisy."""
    noise = campaign.layout.noise
    off = np.array([noise.force] * 3 + [noise.torque] * 3)
    steps, axes = np.nonzero(campaign.schedule.load * off)
    machine = campaign.truth.machine
    readings = np.zeros((*campaign.readings.shape, len(steps)))
    signals = np.zeros((*campaign.signals.shape, len(steps)))
    column = np.arange(len(steps))
    readings[steps, :, column] = (machine.compliance[:, axes] * off[axes]).T
    tension = machine.tension[bridges(campaign.layout)][:, axes] * off[axes]
    signals[steps, :, column] = (campaign.truth.gain[:, :1] * tension).T
    return _flat(campaign, readings, signals)
