"""A sensor within its tolerances: compliance and leg forces as functions of what is not known of it.

Unknowns are counted in standard deviations: length errors of the legs, to first order, and the logarithms of elastic
parameters, exactly: of each part one that all legs share, and one of each leg's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.simulation.six_upur.assembly import SOURCES
from truing.simulation.six_upur.compliance_change import motion_of_sources
from truing.simulation.six_upur.geometry import JointCentres, leg_axes
from truing.simulation.six_upur.influence import influence_matrix
from truing.simulation.six_upur.stiffness import ElasticSensor, end_transport

_LEGS = 6
_MIDDLE, _INSTALLED = SOURCES.index("middle_clearance"), SOURCES.index("sensor_installation")
_TINY = 1e-30


@dataclass(frozen=True)
class Response:
    """How a sensor answers: compliance (..., 6, 6), SI, and leg forces (..., M, 6, 6) by wrench as M models have them.

    The first model is that of joints that resist nothing; the second, of elastic legs, is what runs along these.
    """

    compliance: NDArray
    forces: NDArray


@dataclass(frozen=True)
class UncertainSensor:
    """A sensor of elastic legs, or of a given compliance (6, 6), SI, with what tolerances leave open of it.

    geometry_sigma: (5,) m, by error source, 0 where exact; stiffness_sigma: relative, of every elastic parameter. Where
    no joints are known there are no leg forces (M = 0).
    """

    joints: JointCentres | None
    elastic: ElasticSensor | None = None
    given: NDArray | None = None
    geometry_sigma: NDArray = field(default_factory=lambda: np.zeros(len(SOURCES)))
    stiffness_sigma: float = 0.0

    def __post_init__(self) -> None:
        if (self.elastic is None) == (self.given is None):
            raise ValueError("sensor: found both or none of elements and compliance, expected one of them")

    @cached_property
    def sources(self) -> NDArray:
        """Return which of the 30 length errors (leg by leg) are unknown."""
        if self.joints is None:
            return np.zeros(0, int)
        return np.flatnonzero(np.tile(np.asarray(self.geometry_sigma) > 0.0, _LEGS))

    @property
    def models(self) -> int:
        """Return the number M of models of the leg forces."""
        return 0 if self.joints is None else 1 if self.elastic is None else 2

    @property
    def geometry_size(self) -> int:
        """Return the number of unknown length errors."""
        return len(self.sources)

    @property
    def stiffness_size(self) -> int:
        """Return the number of unknown elastic parameters: common ones first, then leg by leg; one for all if given."""
        if self.stiffness_sigma == 0.0:
            return 0
        return 1 if self.elastic is None else (1 + _LEGS) * len(self.elastic.parts.names)

    def at(self, geometry: NDArray, stiffness: NDArray) -> Response:
        """Return the response at unknowns (geometry_size,) and (..., stiffness_size), in standard deviations."""
        slopes, plain = self.by_geometry, self._elastically(stiffness)
        return Response(
            plain.compliance + np.tensordot(geometry, slopes.compliance, 1),
            plain.forces + np.tensordot(geometry, slopes.forces, 1),
        )

    def by_stiffness(self, stiffness: NDArray) -> Response:
        """Return the response's derivatives by the elastic unknowns, of which there is one more leading axis."""
        nudged = stiffness + 1j * _TINY * np.eye(self.stiffness_size)
        return _imaginary(self._elastically(nudged))

    @cached_property
    def by_geometry(self) -> Response:
        """Return the response's derivatives by the length errors, of which there is one more leading axis."""
        if self.joints is None or not self.geometry_size:
            return Response(np.zeros((0, 6, 6)), np.zeros((0, self.models, 6, 6)))
        motion = motion_of_sources(self.joints)

        def moved(place: NDArray, by: NDArray) -> NDArray:
            return np.asarray(place + 1j * _TINY * np.moveaxis(by, -1, 0))

        joints = JointCentres(
            moved(self.joints.lower, motion.lower),
            moved(self.joints.arm, motion.arm),
            moved(self.joints.origin, motion.origin),
        )
        sigma = np.tile(self.geometry_sigma, _LEGS)[self.sources]
        found = _imaginary(self._response(joints, lambda: self._lengthened()))
        return Response(
            found.compliance[self.sources] * sigma[:, None, None],
            found.forces[self.sources] * sigma[:, None, None, None],
        )

    def _elastically(self, stiffness: NDArray) -> Response:
        """Return the response of the nominal geometry with other elastic parameters."""
        if self.elastic is None:
            softer = np.exp(-np.sum(stiffness, -1) * self.stiffness_sigma)
            plain = self._response(self.joints, lambda: np.zeros(0))
            return Response(plain.compliance * softer[..., None, None], plain.forces)
        parts = self.elastic.parts.compliance
        count = parts.shape[-3]
        logs = np.zeros((*stiffness.shape[:-1], _LEGS, count))
        if stiffness.shape[-1]:
            each = stiffness.reshape(*stiffness.shape[:-1], 1 + _LEGS, count) * self.stiffness_sigma
            logs = each[..., :1, :] + each[..., 1:, :]
        giving = np.einsum("...lp,lpij->...lij", np.exp(-logs), parts)
        return self._response(self.joints, lambda: giving)

    def _lengthened(self) -> NDArray:
        """Return the legs' compliances (30, 6, 6, 6) with each length error as a tiny imaginary part."""
        assert self.elastic is not None
        parts = self.elastic.parts
        found = np.broadcast_to(parts.compliance.sum(-3), (_LEGS, len(SOURCES), _LEGS, 6, 6)).astype(complex)
        legs = np.arange(_LEGS)
        for source, slope in ((_MIDDLE, parts.by_middle), (_INSTALLED, parts.by_installed)):
            found[legs, source, legs] += 1j * _TINY * slope.sum(-3)
        return found.reshape(-1, _LEGS, 6, 6)

    def _response(self, joints: JointCentres | None, giving: Callable[[], NDArray]) -> Response:
        """Return the response of joints with legs of compliances (..., 6, 6, 6)."""
        passive = [] if joints is None else [np.linalg.inv(influence_matrix(joints))]
        if self.elastic is None or joints is None:
            given = np.asarray(self.given)
            lead = passive[0].shape[:-2] if passive else ()
            return Response(np.broadcast_to(given, (*lead, 6, 6)), _stacked(passive, lead))
        transport = end_transport(joints.arm, leg_axes(joints.direction))
        stiffness = transport @ np.linalg.inv(giving()) @ np.swapaxes(transport, -1, -2)
        compliance = np.linalg.inv(stiffness.sum(-3))
        carried = stiffness @ compliance[..., None, :, :]
        along = np.einsum("...li,...lij->...lj", joints.direction, carried[..., :3, :])
        return Response(compliance, _stacked([*passive, along], compliance.shape[:-2]))


def _stacked(forces: list[NDArray], lead: tuple[int, ...]) -> NDArray:
    """Return models of the leg forces (..., M, 6, 6)."""
    if not forces:
        return np.zeros((*lead, 0, 6, 6))
    return np.stack([np.broadcast_to(one, (*lead, 6, 6)) for one in forces], -3)


def _imaginary(response: Response) -> Response:
    return Response(response.compliance.imag / _TINY, response.forces.imag / _TINY)
