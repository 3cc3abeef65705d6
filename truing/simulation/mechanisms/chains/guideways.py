"""Class `GuidewayError`: the carriage of a slide leaves its straight line, or turns, as it moves along the guideway.

These are the component errors of a linear axis by ISO 230-1: two straightness errors, roll, pitch and yaw. The sixth,
along the travel, is a gain, a periodic error or an error curve of the joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from truing.arrays import Array
from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.mechanisms.chains.causes import ChainCause, ChainScene
from truing.simulation.mechanisms.chains.conditions import ChainInputs, usual_range
from truing.simulation.mechanisms.chains.tree import Node

SHIFT, TURN = "shift", "turn"
_SHIFT_M, _TURN_RAD = 2e-5, 5e-5  # plausible sizes of one term
_DEGREES = (2, 3, 5, 8)  # highest of a form; a shift linear in the travel is a direction of the axis, so geometry
_READINGS_EACH, _POSES_EACH = 2, 8  # distinct readings and poses for each term
_MM, _IN_CURVE = 1e-3, 201
_AXES = "xyz"


@dataclass(frozen=True)
class GuidewayCurve:
    """Error of a guideway at m readings (m), with its standard deviation, m or rad.

    A shift is measured from the straight line through both ends, a turn from the direction at the start.
    """

    readings: Array
    deviation: Array
    sigma: Array


@dataclass(frozen=True)
class GuidewayError(ChainCause):
    """The carriage of a slide shifts along, or turns about, one axis of the joint's frame by a polynomial of its
    reading.

    ``error`` is SHIFT or TURN, ``axis`` x, y or z; a shift is at right angles to the travel. The polynomial of
    ``degree`` has Legendre terms over the travel from ``low`` to ``high`` (m), which keep their values beyond. Shift
    and turn act where the carriage is.
    """

    joint: str = ""
    error: str = SHIFT
    axis: str = "y"
    degree: int = 2
    low: float = 0.0
    high: float = 1.0

    id = "guideway-error"
    step = Step.STRUCTURE

    @property
    def subject(self) -> str:
        """The joint."""
        return f"joint {self.joint}"

    @property
    def family(self) -> str:
        """The joint, and the motion of its carriage."""
        return f"{self.id} {self.joint} {self.error} {self.axis}"

    @property
    def has_law(self) -> bool:
        """False: it claims that the error follows the travel, not how."""
        return False

    def candidates(self, scene: ChainScene) -> Sequence[GuidewayError]:
        """Return the five motions of the carriage of every slide, with as many terms as readings and poses allow."""
        machine, result = scene.inputs_of_machine, []
        for k in np.flatnonzero(~machine.tree.is_revolute):
            reading, node = machine.readings[:, k], machine.tree.nodes[machine.tree.node_of(int(k))]
            low, high = map(float, usual_range(reading))
            if not high > low:
                continue
            distinct = len(np.unique(np.round((reading - low) / (high - low), 3)))
            for error, axis, degree in _forms(node):
                cause = replace(self, joint=node.joint, error=error, axis=axis, degree=degree, low=low, high=high)
                terms = len(cause.parameters(0))
                if distinct >= _READINGS_EACH * (degree + 1) and len(reading) >= _POSES_EACH * terms:
                    result.append(cause)
        return result

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the sizes of the Legendre terms: of a shift from degree 2 on, of a turn from 1 on."""
        size = ("mm", _SHIFT_M, _MM) if self.error == SHIFT else ("rad", _TURN_RAD)
        return tuple(Parameter(f"degree_{k}", *size) for k in range(self._lowest, self.degree + 1))

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return the twist of the slide's node, in front of the joint, that moves the carriage where it is."""
        reading = machine.tree.readings.index(self.joint)
        number = machine.tree.node_of(reading)
        result = np.zeros((len(machine.readings), machine.tree.size, 6, len(self.parameters(0))))
        terms, unit = self._terms(machine.readings[:, reading]), np.eye(3)[_AXES.index(self.axis)]
        node = machine.tree.nodes[number]
        if self.error == SHIFT:
            across = unit - (unit @ node.axis) * node.axis
            result[:, number, :3] = (across / np.sqrt(across @ across))[:, None] * terms[:, None]
            return result
        travelled = node.factor * machine.readings[:, reading] + node.shift
        result[:, number, 3:] = unit[:, None] * terms[:, None]
        result[:, number, :3] = np.cross(node.axis, unit)[:, None] * (travelled[:, None] * terms)[:, None]
        return result

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the terms, and the largest deviation over the travel: from the straight line through both ends, or
        from the direction at the start."""
        curve = self.curve(values, covariance)
        k = int(np.argmax(np.abs(curve.deviation)))
        parameter = self.parameters(0)[0]
        sizes = abs(curve.deviation[k]) / parameter.si, curve.sigma[k] / parameter.si
        return (*super().reported(values, covariance, legs), ReportedParameter("largest", *sizes, parameter.unit))

    def curve(self, values: NDArray, covariance: NDArray) -> GuidewayCurve:
        """Return the error over the travel, from parameters (P,) and their covariance (P, P), SI."""
        readings = np.linspace(self.low, self.high, _IN_CURVE)
        terms = self._terms(readings)
        share = np.linspace(0.0, 1.0, _IN_CURVE)[:, None]
        away = terms - (terms[:1] + share * (terms[-1:] - terms[:1]) if self.error == SHIFT else terms[:1])
        variance = np.sum((away @ covariance) * away, -1)
        return GuidewayCurve(readings, away @ values, np.sqrt(np.maximum(variance, 0.0)))

    @property
    def _lowest(self) -> int:
        return 2 if self.error == SHIFT else 1

    def _terms(self, reading: NDArray) -> Array:
        """Return the Legendre terms (B, P) at readings (B,), m."""
        x = np.clip(2.0 * (reading - self.low) / (self.high - self.low) - 1.0, -1.0, 1.0)
        return np.asarray(legendre.legvander(x, self.degree)[:, self._lowest :])


def _forms(node: Node) -> list[tuple[str, str, int]]:
    """Return error, axis and degree of every form: no shift along the travel."""
    along = _AXES[int(np.argmax(np.abs(node.axis)))]
    motions = [(SHIFT, axis) for axis in _AXES if axis != along] + [(TURN, axis) for axis in _AXES]
    return [(motion, axis, degree) for motion, axis in motions for degree in _DEGREES]
