"""Class `UncertainSensor`: compliance and leg forces of a sensor as functions of its uncertain dimensions and
stiffnesses.

Unknowns are in standard deviations: length errors of the legs, to first order, and the logarithms of elastic
parameters, exactly. Each elastic part has one parameter common to all legs, and one per leg.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.simulation.bench.load_steps import LegElasticity
from truing.simulation.bench.six_upur.assembly import SOURCES, motion_of_sources
from truing.simulation.bench.six_upur.geometry import JointCentres, leg_axes
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.stiffness import ElasticSensor, end_transport

_LEGS = 6
_MIDDLE, _INSTALLED = SOURCES.index("middle_clearance"), SOURCES.index("sensor_installation")
_TINY = 1e-30


@dataclass(frozen=True)
class Response:
    """Compliance (..., 6, 6), SI, of a sensor, and leg forces (..., M, 6, 6) by wrench in M models.

    The first model has joints without stiffness. The second has elastic legs and takes the forces along them; for a
    given compliance, it takes forces proportional to the elongation of the legs.
    """

    compliance: NDArray
    forces: NDArray


@dataclass(frozen=True)
class UncertainSensor:
    """A sensor of elastic legs within its tolerances; a ``given`` compliance (6, 6) replaces that of the legs.

    The legs of a given compliance are assumed to be equal; each may still have its own errors. A given compliance of
    zero means that the elasticity of the legs is unknown. geometry_sigma: (5,) m, by error source, 0 if exact;
    stiffness_sigma: relative, of every elastic parameter; ``share`` of its square is common to all legs: legs of one
    bar have a common error, legs made one by one do not, and the declaration does not distinguish these. Without joints
    there are no leg forces (M = 0).
    """

    joints: JointCentres | None
    elastic: ElasticSensor | None = None
    given: NDArray | None = None
    geometry_sigma: NDArray = field(default_factory=lambda: np.zeros(len(SOURCES)))
    stiffness_sigma: float = 0.0
    share: float = 0.5

    def __post_init__(self) -> None:
        if self.elastic is None and self.given is None:
            raise ValueError("sensor: found neither elements nor a compliance, expected one of them")

    @property
    def _is_elastic(self) -> bool:
        """True if the compliance is that of the legs' elements."""
        return self.elastic is not None and (self.given is None or np.array_equal(self.given, self.elastic.compliance))

    @cached_property
    def sources(self) -> NDArray:
        """Indices of the unknown ones among the 30 length errors (leg by leg)."""
        if self.joints is None:
            return np.zeros(0, int)
        return np.flatnonzero(np.tile(np.asarray(self.geometry_sigma) > 0.0, _LEGS))

    @property
    def models(self) -> int:
        """Number M of models of the leg forces."""
        return 0 if self.joints is None else 2 if self.elastic is not None or np.any(self.given) else 1

    @property
    def geometry_size(self) -> int:
        """Number of unknown length errors."""
        return len(self.sources)

    @property
    def stiffness_size(self) -> int:
        """Number of unknown elastic parameters: common ones first, then leg by leg; one if there are no legs."""
        if self.stiffness_sigma == 0.0:
            return 0
        if self.elastic is not None and self._is_elastic:
            return (1 + _LEGS) * len(self.elastic.parts.names)
        return 1 if self._equal_legs is None else 1 + _LEGS

    @cached_property
    def _equal_legs(self) -> NDArray | None:
        """Stiffnesses (6, 6, 6), SI, of equal legs that explain a given compliance; None if there are none."""
        if (
            self.joints is None
            or self._is_elastic
            or np.linalg.matrix_rank(self._given_numbers((6, 6)), hermitian=True) < _LEGS
        ):
            return None
        return equal_legs(np.linalg.inv(self._given_numbers((6, 6))), self.joints)

    @cached_property
    def legs(self) -> LegElasticity | None:
        """Flexible parts of each leg at the platform's origin; None if the elements are unknown."""
        if self.elastic is None or not self._is_elastic:
            return None
        back = np.linalg.inv(self.elastic.leg_transport)[:, None]
        parts = np.swapaxes(back, -1, -2) @ self.elastic.parts.compliance @ back
        return LegElasticity(tuple(self.elastic.parts.names), parts, self.elastic.compliance)

    @property
    def is_split(self) -> bool:
        """True if elastic parameters have a part common to all legs and one per leg."""
        return self.stiffness_size > 1

    @property
    def unknowns(self) -> list[tuple[int | None, str]]:
        """Leg (from 1; None if common to all) and name of each unknown, lengths first."""
        named: list[tuple[int | None, str]] = [
            (int(source) // len(SOURCES) + 1, SOURCES[int(source) % len(SOURCES)]) for source in self.sources
        ]
        legs: list[int | None] = [None, *range(1, _LEGS + 1)]
        if self.elastic is None or not self._is_elastic:
            return [*named, *((leg, "stiffness") for leg in legs[: self.stiffness_size])]
        parts = self.elastic.parts.names if self.stiffness_size else ()
        return [*named, *((leg, f"stiffness of {part}") for leg in legs for part in parts)]

    @property
    def scales(self) -> NDArray:
        """Standard deviation of each unknown: m for lengths, relative for stiffnesses."""
        lengths = np.tile(self.geometry_sigma, _LEGS)[self.sources]
        common = np.array([leg is None for leg, _ in self.unknowns[self.geometry_size :]], bool)
        share = np.where(common, self.share, 1.0 - self.share) if self.is_split else np.ones(self.stiffness_size)
        return np.concatenate([lengths, np.sqrt(share) * self.stiffness_sigma])

    def at(self, geometry: NDArray, stiffness: NDArray) -> Response:
        """Return the response at unknowns (geometry_size,) and (..., stiffness_size), in standard deviations."""
        slopes, plain = self.by_geometry, self._elastic_response(stiffness)
        return Response(
            plain.compliance + np.tensordot(geometry, slopes.compliance, 1),
            plain.forces + np.tensordot(geometry, slopes.forces, 1),
        )

    def by_stiffness(self, stiffness: NDArray) -> Response:
        """Return the response's derivatives by the elastic unknowns, with one more leading axis."""
        nudged = stiffness + 1j * _TINY * np.eye(self.stiffness_size)
        return _imaginary(self._elastic_response(nudged))

    @cached_property
    def by_geometry(self) -> Response:
        """Derivatives of the response by the length errors, with one more leading axis."""
        if self.joints is None or not self.geometry_size:
            return Response(np.zeros((0, 6, 6)), np.zeros((0, self.models, 6, 6)))
        motion = motion_of_sources(self.joints)

        def moved(index: NDArray, by: NDArray) -> NDArray:
            return np.asarray(index + 1j * _TINY * np.moveaxis(by, -1, 0))

        joints = JointCentres(
            moved(self.joints.lower, motion.lower),
            moved(self.joints.arm, motion.arm),
            moved(self.joints.origin, motion.origin),
        )
        sigma = np.tile(self.geometry_sigma, _LEGS)[self.sources]
        response = _imaginary(self._response(joints, self._lengthened()))
        return Response(
            response.compliance[self.sources] * sigma[:, None, None],
            response.forces[self.sources] * sigma[:, None, None, None],
        )

    def _elastic_response(self, stiffness: NDArray) -> Response:
        """Return the response of the nominal geometry with other elastic parameters."""
        lead = stiffness.shape[:-1]
        if self.elastic is None or not self._is_elastic:
            giving = None if self.elastic is None else self.elastic.parts.compliance.sum(-3)
            plain = self._response(self.joints, giving)
            forces = np.broadcast_to(plain.forces, (*lead, *plain.forces.shape))
            return Response(self._softened(stiffness), forces.astype(stiffness.dtype))
        parts = self.elastic.parts.compliance
        count = parts.shape[-3]
        logs = np.zeros((*lead, _LEGS, count))
        if stiffness.shape[-1]:
            logs = self._each_leg(stiffness.reshape(*lead, 1 + _LEGS, count))
        return self._response(self.joints, np.einsum("...lp,lpij->...lij", np.exp(-logs), parts))

    def _each_leg(self, stiffness: NDArray) -> NDArray:
        """Return the logarithms (..., 6, P) of each leg's relative parameters from unknowns (..., 7, P), common ones
        first."""
        common, own_sigma = self.stiffness_sigma * np.sqrt([self.share, 1.0 - self.share])
        return np.asarray(common * stiffness[..., :1, :] + own_sigma * stiffness[..., 1:, :])

    def _softened(self, stiffness: NDArray) -> NDArray:
        """Return a given compliance (..., 6, 6) with other elastic parameters (..., stiffness_size)."""
        if self._equal_legs is None or not stiffness.shape[-1]:
            softer = np.exp(-np.sum(stiffness, -1) * self.stiffness_sigma)
            return self._given_numbers((6, 6)) * softer[..., None, None]
        stiffer = np.exp(self._each_leg(stiffness[..., None])[..., 0])
        return np.asarray(np.linalg.inv(np.einsum("...l,lij->...ij", stiffer, self._equal_legs)))

    def _lengthened(self) -> NDArray | None:
        """Return the legs' compliances (30, 6, 6, 6), each with one length error as a tiny imaginary part."""
        if self.elastic is None:
            return None
        parts = self.elastic.parts
        compliance = np.broadcast_to(parts.compliance.sum(-3), (_LEGS, len(SOURCES), _LEGS, 6, 6)).astype(complex)
        legs = np.arange(_LEGS)
        for source, slope in ((_MIDDLE, parts.by_middle), (_INSTALLED, parts.by_installed)):
            compliance[legs, source, legs] += 1j * _TINY * slope.sum(-3)
        return compliance.reshape(-1, _LEGS, 6, 6)

    def _response(self, joints: JointCentres | None, giving: NDArray | None) -> Response:
        """Return the response of joints with legs of compliances (..., 6, 6, 6), or without."""
        if joints is None:
            return Response(self._given_numbers((6, 6)), np.zeros((0, 6, 6)))
        G = influence_matrix(joints)
        passive = np.linalg.inv(G)
        if giving is None:
            lead = passive.shape[:-2]
            responses = [passive, self._lengthening(G)][: self.models]
            return Response(self._displaced(G), _stacked(responses, lead))
        transport = end_transport(joints.arm, leg_axes(joints.direction))
        stiffness = transport @ np.linalg.inv(giving) @ np.swapaxes(transport, -1, -2)
        compliance = np.linalg.inv(stiffness.sum(-3))
        carried = stiffness @ compliance[..., None, :, :]
        along = np.einsum("...li,...lij->...lj", joints.direction, carried[..., :3, :])
        forces = _stacked([passive, along], compliance.shape[:-2])
        return Response(compliance if self._is_elastic else self._displaced(G), forces)

    def _displaced(self, G: NDArray) -> NDArray:
        """Return a given compliance (..., 6, 6) for displaced legs with influence matrix G (..., 6, 6)."""
        if self._equal_legs is None or self.joints is None:
            return self._given_numbers(G.shape)
        back = influence_matrix(self.joints) @ np.linalg.inv(G)
        return np.asarray(np.swapaxes(back, -1, -2) @ self._given_numbers((6, 6)) @ back)

    def _lengthening(self, G: NDArray) -> NDArray:
        """Return the forces (..., 6, 6) along equal legs of a given compliance, proportional to their elongation G' C.

        They have the mean size of the forces with joints without stiffness.
        """
        lengthened = np.swapaxes(G, -1, -2) @ np.asarray(self.given)
        size = np.trace(lengthened @ G, axis1=-2, axis2=-1) / _LEGS
        return np.asarray(lengthened / np.where(size == 0.0, 1.0, size)[..., None, None])

    def _given_numbers(self, shape: tuple[int, ...]) -> NDArray:
        return np.broadcast_to(np.asarray(self.given), shape)


@dataclass(frozen=True)
class ComplianceChange:
    """Derivatives of a platform's compliance.

    by_source: (6, 5, 6, 6), by leg and error source, per m; by_stiffness: (6, P, 6, 6), by leg and the logarithm of the
    elastic parameter of each part. For a change common to all legs, the derivative is the sum over legs.
    """

    by_source: NDArray
    by_stiffness: NDArray


def compliance_change(sensor: ElasticSensor) -> ComplianceChange:
    """Return the derivatives of an unloaded, assembled sensor's compliance.

    A length error moves the platform to the pose where its legs close, turns all six legs, and moves the parts in
    between.
    """
    free = UncertainSensor(sensor.joints, sensor, None, np.ones(len(SOURCES)), stiffness_sigma=1.0, share=0.0)
    parts = len(sensor.parts.names)
    by_stiffness = free.by_stiffness(np.zeros(free.stiffness_size)).compliance[parts:]  # after those of all legs
    by_source = free.by_geometry.compliance
    return ComplianceChange(by_source.reshape(_LEGS, -1, 6, 6), by_stiffness.reshape(_LEGS, parts, 6, 6))


def compliance_covariance(change: NDArray, sigma: ArrayLike) -> NDArray:
    """Return the covariance (36, 36) of a compliance, row by row, by independent parameters.

    change: derivatives (..., 6, 6), after any number of axes of parameters; sigma: their standard deviations, of the
    shape of these axes.
    """
    weighed = np.broadcast_to(np.asarray(sigma, float)[..., None, None], change.shape) * change
    flat = weighed.reshape(-1, 36)
    return flat.T @ flat


def _stacked(forces: list[NDArray], lead: tuple[int, ...]) -> NDArray:
    """Stack the models of the leg forces (..., M, 6, 6)."""
    return np.stack([np.broadcast_to(force, (*lead, 6, 6)) for force in forces], -3)


def _imaginary(response: Response) -> Response:
    return Response(response.compliance.imag / _TINY, response.forces.imag / _TINY)


_KINDS = 5  # along, across, twist, bend, and across by bending
_NEARLY_PASSIVE = 1e-2  # largest negative eigenvalue of a leg, relative to the platform's stiffness


def equal_legs(stiffness: NDArray, joints: JointCentres) -> NDArray:
    """Return the stiffness (6, 6, 6), SI, about the platform's origin, of equal legs with a given sum (6, 6)."""
    scale = 1.0 / np.sqrt(np.diag(stiffness))
    scaled = scale[:, None] * scale
    kinds = _kinds(stiffness, joints)
    design = (kinds.sum(1) * scaled).reshape(_KINDS, -1).T
    sizes = np.linalg.lstsq(design, (stiffness * scaled).ravel(), rcond=None)[0]
    sizes_of_legs = np.tensordot(sizes, kinds, 1)
    if np.linalg.eigvalsh(sizes_of_legs * scaled).min() < -_NEARLY_PASSIVE:
        sizes_of_legs = np.zeros_like(sizes_of_legs)
    return sizes_of_legs + _derivative_by_axial_forces(stiffness - sizes_of_legs.sum(0), joints)


def _kinds(stiffness: NDArray, joints: JointCentres) -> NDArray:
    """Return the kinds of leg stiffness (5, 6, 6, 6), by leg, of 1 N/m; moments at the platform's characteristic
    length."""
    moments, forces = np.trace(stiffness[3:, 3:]), np.trace(stiffness[:3, :3])
    length = np.sqrt(moments / forces)
    along = joints.direction[:, :, None] * joints.direction[:, None, :]
    turned = np.cross(joints.direction[:, None, :], np.eye(3)).swapaxes(-1, -2) * length
    kinds_of_legs = np.zeros((_KINDS, _LEGS, 6, 6))
    kinds_of_legs[0, :, :3, :3] = along
    kinds_of_legs[1, :, :3, :3] = np.eye(3) - along
    kinds_of_legs[2, :, 3:, 3:] = along * length**2
    kinds_of_legs[3, :, 3:, 3:] = (np.eye(3) - along) * length**2
    kinds_of_legs[4, :, :3, 3:], kinds_of_legs[4, :, 3:, :3] = turned, turned.swapaxes(-1, -2)
    transport = end_transport(joints.arm, np.broadcast_to(np.eye(3), (_LEGS, 3, 3)))
    return np.asarray(transport @ kinds_of_legs @ transport.swapaxes(-1, -2))


def _derivative_by_axial_forces(stiffness: NDArray, joints: JointCentres) -> NDArray:
    """Return the parts (6, 6, 6) of a stiffness by the force along each leg; exact if legs carry only such forces."""
    G = influence_matrix(joints)
    shares = G.T[:, :, None] * np.linalg.inv(G)[:, None, :] @ stiffness
    return np.asarray(0.5 * (shares + shares.swapaxes(-1, -2)))
