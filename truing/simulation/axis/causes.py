"""Causes of an axis: scale error, growth, lost motion, zero shift; base class `AxisCause`, scene `AxisScene`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Index, Mask
from truing.inference.model import ChannelCandidates, Onsets, onsets_in_time
from truing.simulation.axis.rows import (
    LINEAR,
    LOAD,
    MEASURED,
    MOTOR,
    ROTARY,
    TRANSMISSION,
    Axis,
    AxisRows,
)
from truing.simulation.cause import Cause, ChannelScene, Parameter, ReportedParameter, Step
from truing.simulation.inputs import TEMPERATURE, Missing, varying_columns

# Most probable element first: if readings cannot distinguish two, it is named first.
ELEMENTS = (TRANSMISSION, LOAD, MEASURED, MOTOR)
SUBJECTS = {TRANSMISSION: "axis", MEASURED: "instrument", LOAD: "encoder load", MOTOR: "encoder motor"}
_PLAUSIBLE_SCALE = 1e-4
_PLAUSIBLE_GROWTH = 1e-5  # 1/K
# Fixed points of growth that are tried besides command zero, as shares of the travel.
_FIXED_POINTS = (0.25, 0.5, 0.75)
_PLAUSIBLE = {ROTARY: 3e-4, LINEAR: 2e-5}  # rad, m
_UNITS = {ROTARY: ("rad", 1.0), LINEAR: ("mm", 1e-3)}
# Least number of readings of an encoder before a shift, and after it.
_FEWEST = 3
# Largest number of onsets: in a long campaign, not every row is tried.
_MOST_ONSETS = 200


@dataclass(frozen=True)
class AxisScene(ChannelScene["AxisCause"]):
    """Scene of causes that act on an axis: its encoders, its rows, and the elements whose stops are unknown (H,)."""

    axis: Axis
    rows: AxisRows
    stops: tuple[str, ...] = ()

    @property
    def covariates(self) -> Mapping[str, NDArray]:
        """Columns (B,) that noise may depend on."""
        return self.rows.covariates

    @property
    def size(self) -> tuple[int, int]:
        """Number of rows B and of encoders K."""
        return len(self.rows.poses), len(self.axis.encoders)

    @property
    def inputs(self) -> Mapping[str, NDArray]:
        """Commands (B,)."""
        return {"command": self.rows.command}


@dataclass(frozen=True)
class AxisCause(Cause[AxisScene]):
    """Base class of causes that add to the encoder readings of an axis, to first order: effects do not multiply each
    other."""

    kind_of_axis: str = ROTARY
    plausible: float = 0.0  # plausible size, SI, if the readings deviate by more than the default

    reach = 1e3  # a wrong factor or zero may be large

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return the derivative (B, K, P) of the encoders' readings by the parameters, SI."""
        raise NotImplementedError

    def slopes_at(self, rows: AxisRows, axis: Axis, values: NDArray) -> NDArray:
        """Return the derivative (B, K, P) at values (P,), SI; the same at all values, unless the form has a shape."""
        return self.slopes(rows, axis)

    def shift(self, rows: AxisRows, axis: Axis, values: NDArray) -> NDArray:
        """Return the shift (B, K) of the encoders' readings at values (P,), SI."""
        return np.asarray(self.slopes(rows, axis) @ values)

    @property
    def unit(self) -> tuple[str, float]:
        """Unit of lengths or angles in tables, and its SI value."""
        return _UNITS[self.kind_of_axis]

    def _length(self, name: str) -> Parameter:
        unit, si = self.unit
        return Parameter(name, unit, max(_PLAUSIBLE[self.kind_of_axis], self.plausible), si)


class ElementCause(AxisCause):
    """Base class of causes that act on one ``element`` of an axis: its transmission, an encoder or the instrument."""

    element: str

    @property
    def subject(self) -> str:
        """Encoder, instrument, or the axis for its transmission; empty for all elements together."""
        return SUBJECTS.get(self.element, "")


@dataclass(frozen=True)
class ScaleError(ElementCause):
    """An encoder reads, or the transmission travels, (1 + scale) times the correct amount."""

    element: str = TRANSMISSION

    id = "scale-error"
    step = Step.INSTRUMENT

    def candidates(self, scene: AxisScene) -> Sequence[ScaleError]:
        """Return every element whose factor is observable, if commands differ."""
        if not np.ptp(scene.rows.command) > 0.0:
            return ()
        size = scene.axis.spread / float(np.ptp(scene.rows.command))
        with_axis = replace(self, kind_of_axis=scene.axis.kind, plausible=size)
        return [replace(with_axis, element=name) for name in shown_elements(scene.axis)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the factor minus one."""
        return (Parameter("scale", "1", max(_PLAUSIBLE_SCALE, self.plausible)),)

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return the commands, for the encoders that respond to the factor."""
        return (rows.command[:, None] * axis.response(self.element))[..., None]


@dataclass(frozen=True)
class AxisGrowth(ElementCause):
    """An encoder or the transmission grows with temperature: growth x (temperature - ``reference_c``) x (command -
    ``fixed``).

    ``reference_c`` is the mean temperature of the campaign: a constant part of the growth is a scale error. If
    ``free``, a shift per kelvin is added, which allows for any fixed point.
    """

    element: str = TRANSMISSION
    column: str = TEMPERATURE
    reference_c: float = 0.0
    fixed: float = 0.0  # rad, m
    plausible_shift: float = 0.0  # rad/K, m/K
    free: bool = False

    id = "axis-growth"
    lacking = Missing.TEMPERATURE
    step = Step.STRUCTURE

    @property
    def family(self) -> str:
        """Growth of one element with one temperature, about any point."""
        return f"{self.id} {self.element} {self.column}"

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the column of the temperature."""
        return (self.column,)

    def candidates(self, scene: AxisScene) -> Sequence[AxisGrowth]:
        """Return every observable element with every column of temperatures that varies, about points of the travel.

        A point outside the travel would make growth resemble an effect of the temperature alone.
        """
        command = scene.rows.command
        low, travel = float(command.min()), float(np.ptp(command))
        if not travel > 0.0:
            return ()
        points = [low + share * travel for share in _FIXED_POINTS] + [0.0] * (low <= 0.0 <= low + travel)
        growths = []
        for column, values in varying_columns(scene.rows.covariates).items():
            if is_temperature(column):
                per_k = max(scene.axis.spread, _PLAUSIBLE[scene.axis.kind]) / float(np.ptp(values))
                growth = replace(self, kind_of_axis=scene.axis.kind, column=column, reference_c=float(np.mean(values)))
                growth = replace(growth, plausible=per_k / travel, plausible_shift=per_k)
                elements = shown_elements(scene.axis)
                growths += [replace(growth, element=name, fixed=point) for name in elements for point in points]
        return growths

    def refined(self) -> Self:
        """Return the form with a fitted fixed point."""
        return replace(self, free=True)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the growth per kelvin, then the shift per kelvin at ``fixed`` if it is free."""
        growth = (Parameter("growth", "1/K", max(_PLAUSIBLE_GROWTH, self.plausible)),)
        unit, si = self.unit
        return (*growth, Parameter("shift", f"{unit}/K", self.plausible_shift, si)) if self.free else growth

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return commands from the fixed point, and one if it is free, times the temperatures from the reference."""
        warmer = np.asarray(rows.covariates[self.column]) - self.reference_c
        away = rows.command - self.fixed
        lengths = np.stack([away, np.ones_like(away)][: 1 + self.free], -1)
        return np.asarray((warmer[:, None] * lengths)[:, None] * axis.response(self.element)[:, None])


@dataclass(frozen=True)
class LostMotion(AxisCause):
    """The load lags the motor by backlash x direction of approach; the full gap is twice the backlash.

    A controller that compensates for too large a gap makes it negative.
    """

    id = "lost-motion"
    lacking = Missing.APPROACH
    step = Step.STRUCTURE

    def candidates(self, scene: AxisScene) -> Sequence[LostMotion]:
        """Return the cause if an encoder responds to it and rows were approached from both sides."""
        both = np.ptp(scene.rows.direction) > 0.0 and bool(shown_elements(scene.axis, (TRANSMISSION,)))
        return (replace(self, kind_of_axis=scene.axis.kind, plausible=scene.axis.spread),) if both else ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return half of the gap."""
        return (self._length("backlash"),)

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return minus the direction of approach, for the encoders that respond to the transmission."""
        return (-rows.direction[:, None] * axis.response(TRANSMISSION))[..., None]


@dataclass(frozen=True)
class ZeroShift(ElementCause):
    """An encoder or the transmission is shifted from a time on: after an event, or from an onset."""

    element: str = TRANSMISSION
    from_pose: int | str = ""
    from_s: float = -np.inf
    event: str = ""

    id = "zero-shift"
    step = Step.INSTRUMENT
    is_persistent = False

    def candidates(self, scene: AxisScene) -> Sequence[ZeroShift]:
        """Return every element whose zero is observable, after each event; `channel_candidates` has other onsets."""
        zero_shifts: list[ZeroShift] = []
        for event, start in scene.rows.events:
            late: Mask = np.greater_equal(scene.rows.time_s, start)
            first = int(np.argmin(np.where(late, scene.rows.time_s, np.inf)))
            if late.any() and _both_sides(scene, late[None])[0].any():
                zero_shifts += [self._shift_of(scene, name, first, start, event) for name in shown_elements(scene.axis)]
        return zero_shifts

    def channel_candidates(self, scene: AxisScene) -> Sequence[ChannelCandidates[ZeroShift]]:
        """Return every element from every row on that has enough rows on either side."""
        elements, onsets = shown_elements(scene.axis), onset_rows(scene.rows, _FEWEST)
        if not len(onsets) or not elements:
            return ()
        late: Mask = np.greater_equal(scene.rows.order, scene.rows.order[onsets][:, None])
        usable = np.repeat(np.asarray(_both_sides(scene, late).any(1))[:, None], len(elements), 1)
        each = np.tile(np.arange(len(scene.axis.encoders)), (len(elements), 1))
        patterns = np.stack([scene.axis.response(name) for name in elements])[..., None, None]

        def member(element: int, onset: int) -> ZeroShift:
            row = int(onsets[onset])
            return self._shift_of(scene, elements[element], row, float(scene.rows.time_s[row]), "")

        scale = max(_PLAUSIBLE[scene.axis.kind], scene.axis.spread)
        return [ChannelCandidates(late[..., None].astype(float), each, usable, scale, member, patterns)]

    def onsets(self, scene: AxisScene) -> Onsets[ZeroShift] | None:
        """Return every row with enough rows before it and from it on; None for a shift after an event."""
        if self.event:
            return None
        rows = scene.rows

        def begun_at(row: int) -> ZeroShift:
            return replace(self, from_pose=rows.poses[row], from_s=float(rows.time_s[row]))

        return onsets_in_time(rows.time_s, _FEWEST, _onset_spacing(rows), self.from_s, begun_at)

    def _shift_of(self, scene: AxisScene, element: str, row: int, start: float, event: str) -> ZeroShift:
        pose = scene.rows.poses[row]
        shift = replace(self, kind_of_axis=scene.axis.kind, plausible=scene.axis.spread)
        return replace(shift, element=element, from_pose=pose, from_s=start, event=event)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift."""
        return (self._length("shift"),)

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return one, from the time on, for the encoders that respond to the shift."""
        late = (rows.time_s >= self.from_s).astype(float)
        return (late[:, None] * axis.response(self.element))[..., None]

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the shift, and its event or first row."""
        since = (
            ReportedParameter("event", self.event, None, "")
            if self.event
            else ReportedParameter("from_pose", str(self.from_pose), None, "")
        )
        return (*super().reported(values, covariance, legs), since)


def is_temperature(column: str) -> bool:
    """True if a column holds temperatures: ``temperature_c``, ``scale_temperature_c``."""
    return column.endswith(TEMPERATURE)


def shown_elements(axis: Axis, elements: Sequence[str] = ELEMENTS) -> list[str]:
    """Return the elements to which any recorded encoder responds."""
    return [name for name in elements if axis.response(name).any()]


def onset_rows(rows: AxisRows, fewest: int) -> Index:
    """Return the rows (S,), in order of time, of possible onsets: with at least ``fewest`` rows before and from
    them."""
    in_time = np.argsort(rows.order, kind="stable")
    return in_time[fewest : len(in_time) - fewest + 1 : _onset_spacing(rows)]


def _onset_spacing(rows: AxisRows) -> int:
    """Return the spacing of the onsets that are tried."""
    return 1 + len(rows.order) // _MOST_ONSETS


def _both_sides(scene: AxisScene, late: NDArray) -> NDArray:
    """Return the mask (S, K) of encoders read often enough before and from each of S onsets, late (S, B)."""
    seen = scene.recorded.astype(int)
    after = late.astype(int) @ seen
    return np.asarray((after >= _FEWEST) & (seen.sum(0) - after >= _FEWEST))
