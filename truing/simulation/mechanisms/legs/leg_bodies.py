"""Calibration with measured poses of the legs: the ends of each leg's body coincide with the joints of the mechanism.

In the survey frame of a leg, its lower joint is at c0, and the upper one a leg's length from it along w. Both are
unknown, five numbers per leg. The conditions at the two ends replace the leg's closure equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, left_jacobian_so3, skew
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import attachments, shortest_turn, unit, upper_joints
from truing.simulation.mechanisms.parameters import LegParameter
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel, in_plane_change, shift_change
from truing.simulation.mechanisms.structures.structure import Closing, Machine, Structure

_OWN = 5  # unknowns per leg: c0, and the two smallest components of w


@dataclass(frozen=True)
class LegPoses:
    """Measured poses of the survey frames of legs (K,), from 0, in the base frame, and whether each was seen."""

    leg: NDArray
    R: NDArray  # (B, K, 3, 3)
    t: NDArray  # (B, K, 3) m
    is_observed: NDArray  # (B, K) bool


@dataclass(frozen=True)
class LegEndClosing:
    """Closure equations with the ends of legs, and their derivatives by deviations of the legs' poses and by their
    numbers."""

    closing: Closing
    by_deviation: NDArray  # (..., M, 6 K)
    by_values: NDArray  # (..., M, 5 K)


@dataclass(frozen=True)
class LegBodies:
    """Poses R (B, K, 3, 3), t (B, K, 3) m of the survey frames of legs (K,), from 0, in the base frame.

    c (K, 3), m, and w (K, 3) are the expected lower joint and direction in those frames.
    """

    leg: NDArray
    R: NDArray
    t: NDArray
    c: NDArray
    w: NDArray

    @property
    def entries(self) -> tuple[LegParameter, ...]:
        """Additional parameters to identify, leg by leg: c0, then two components of w."""
        parameters: list[LegParameter] = []
        for leg, axes in zip(self.leg, self._free(), strict=True):
            parameters += [LegParameter(f"c_{axis}", int(leg), "mm", 1e-3) for axis in "xyz"]
            parameters += [LegParameter(f"w_{'xyz'[axis]}", int(leg), "1", 1.0) for axis in axes]
        return tuple(parameters)

    @property
    def start(self) -> NDArray:
        """Expected values (5 K,), SI."""
        return np.concatenate([self.c, np.take_along_axis(self.w, self._free(), -1)], -1).ravel()

    @property
    def deviations(self) -> int:
        """Number of deviations per pose: 6 K."""
        return 6 * len(self.leg)

    def fits(self, structure: Structure, machine: Machine) -> bool:
        """True if legs are single rigid bodies, in a model that closes a leg by its length minus the distance of its
        joints."""
        single = isinstance(structure, KinematicModel) or structure.name == "beam"
        return single and machine.legs.closure.one_body

    def with_end_closures(self, values: NDArray, deviation: NDArray, closing: Closing, joints: Joints) -> LegEndClosing:
        """Replace the closure equations of these legs by the conditions at their ends: six per leg, after the other
        equations.

        values (..., 5 K) in the order of `entries`; deviation (..., B, 6 K) of the legs' poses, (v; theta) leg by leg.
        """
        parts = deviation.reshape(*deviation.shape[:-1], len(self.leg), 6)
        R, turn = exp_so3(parts[..., 3:]) @ self.R, left_jacobian_so3(parts[..., 3:])
        c, w, slope = self._seats_on_legs(values)
        length, length_slope = joints.lengths(closing)
        along, near = _rotated(R, w), _rotated(R, c)
        far = near + length[..., None] * along
        origin = self.t + parts[..., :3]
        value = np.stack([near + origin - joints.lower, far + origin - joints.upper], -2)
        ends = np.stack([-joints.lower_slope, along[..., None] * length_slope[..., None, :] - joints.upper_slope], -3)
        by_pose = [concatenated(arm.shape, np.eye(3), -skew(arm) @ turn) for arm in (near, far)]
        by_seat = [concatenated(far.shape, R, size[..., None, None] * (R @ slope)) for size in (0.0 * length, length)]
        return _with_end_rows(self.leg, closing, value, ends, np.stack(by_pose, -3), np.stack(by_seat, -3))

    def _free(self) -> NDArray:
        """Return the axes (K, 2) of the two smallest components of the expected directions."""
        return np.sort(np.argsort(np.abs(self.w), -1, kind="stable")[:, :2], -1)

    def _seats_on_legs(self, values: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return c0 and w (..., K, 3) at values (..., 5 K), and dw (..., K, 3, 2) by its two components."""
        parts = values.reshape(*values.shape[:-1], len(self.leg), _OWN)
        free = np.eye(3)[self._free()]
        largest = 1.0 - free.sum(1)
        across = np.einsum("...kj,kji->...ki", parts[..., 3:], free)
        square = 1.0 - np.sum(across * across, -1)
        largest_component = np.sqrt(np.where(square.real < 0.0, np.nan, square)) * np.sign(np.sum(largest * self.w, -1))
        follows = largest[..., None] * (parts[..., None, 3:] / largest_component[..., None, None])
        return parts[..., :3], across + largest_component[..., None] * largest, np.swapaxes(free, -1, -2) - follows


def _with_end_rows(
    leg: NDArray, closing: Closing, value: NDArray, ends: NDArray, by_pose: NDArray, by_seat: NDArray
) -> LegEndClosing:
    """Append six rows per leg (..., K, 2, 3, own) to the equations of the other legs."""
    other_channels = np.setdiff1d(np.arange(closing.value.shape[-1]), leg)
    rows = ends.reshape(*ends.shape[:-4], -1, ends.shape[-1])
    slopes = np.concatenate([stacked(closing)[..., other_channels, :], rows], -2)
    values = np.concatenate([closing.value[..., other_channels], value.reshape(*value.shape[:-3], -1)], -1)
    parts = np.split(slopes, [6, 6 + closing.by_rho.shape[-1]], -1)
    rows_of_ends = (
        _columns_per_leg(array.reshape(*array.shape[:-4], -1, array.shape[-1]), len(other_channels))
        for array in (by_pose, by_seat)
    )
    return LegEndClosing(Closing(values, *parts), *rows_of_ends)


def _columns_per_leg(rows: NDArray, other_channels: int) -> NDArray:
    """Return rows (..., 6 K, own) with separate columns for each leg, (..., M, K own); zero for the other legs."""
    legs = rows.shape[-2] // 6
    wide = np.zeros((*rows.shape[:-2], other_channels + rows.shape[-2], legs * rows.shape[-1]), rows.dtype)
    by_leg = np.repeat(np.eye(legs), 6, 0)[:, :, None] * rows[..., :, None, :]
    wide[..., other_channels:, :] = by_leg.reshape(*rows.shape[:-1], -1)
    return wide


def seated(legs: Legs, p: NDArray, R: NDArray, rho: NDArray, measured: LegPoses) -> LegBodies:
    """Return the legs' bodies with seats that best fit the nominal legs on average over the poses.

    p (B, 3), R (B, 3, 3), rho (B, L): measured platform and readings. A pose in which a leg was not seen gets a fitting
    value, which carries no information if its covariance is wide.
    """
    lower = legs.closure.lower(legs, rho)[:, measured.leg]
    z = unit(upper_joints(legs, p, R)[:, measured.leg] - lower)
    first = np.argmax(measured.is_observed, 0), np.arange(len(measured.leg))
    turned = np.where(measured.is_observed[..., None, None], measured.R, shortest_turn(z[first], z) @ measured.R[first])
    back = np.swapaxes(turned, -1, -2)
    weight = measured.is_observed / measured.is_observed.sum(0)
    c = np.einsum(
        "bk,bki->ki", weight, _rotated(back, lower - np.where(measured.is_observed[..., None], measured.t, 0.0))
    )
    w = unit(np.einsum("bk,bki->ki", weight, _rotated(back, z)))
    t = np.where(measured.is_observed[..., None], measured.t, lower - _rotated(turned, c))
    return LegBodies(measured.leg, turned, t, c, w)


def _rotated(R: NDArray, v: NDArray) -> NDArray:
    return (R @ v[..., None])[..., 0]


@dataclass(frozen=True)
class Joints:
    """Joints of some legs (K,), m, base frame; derivatives by D = 6 + L + P: platform's twist, readings, parameters."""

    leg: NDArray
    lower: NDArray  # (..., K, 3)
    upper: NDArray  # (..., K, 3)
    lower_slope: NDArray  # (..., K, 3, D)
    upper_slope: NDArray  # (..., K, 3, D)

    def lengths(self, closing: Closing) -> tuple[NDArray, NDArray]:
        """Return the leg lengths (..., K), m, in a model of single legs, and the derivatives (..., K, D).

        The closure of such a model is this length minus the distance of the joints.
        """
        g = self.upper - self.lower
        distance = np.sqrt(np.sum(g * g, -1))
        slope = np.einsum("...ki,...kid->...kd", g / distance[..., None], self.upper_slope - self.lower_slope)
        return closing.value[..., self.leg] + distance, stacked(closing)[..., self.leg, :] + slope


def joints_of(leg: NDArray, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Joints:
    """Return the joints of legs (K,), from 0, at poses p (..., 3), R (..., 3, 3) and readings rho (..., L)."""
    legs, shift = machine.bent_legs(rho), machine.delta_bz(rho)
    upper, lower = upper_joints(legs, p, R, shift), legs.closure.lower(legs, rho)
    arms = attachments(legs, shift) @ np.swapaxes(R, -1, -2)
    axis = R[..., None, :, 2, None]
    driven = legs.closure.lower_change(legs, rho, Change({"rho": np.eye(legs.count)}, legs.count))
    moved = np.einsum("...ij,...ljp->...lip", R, change.get("b", (legs.count, 3)))
    bent = axis * shift_change(machine, rho, change)[..., None, :]
    bent = bent + np.einsum("...ij,...ljp->...lip", R[..., :2], in_plane_change(machine, rho, change))
    driven_above = np.einsum("...ij,...ljk->...lik", R, machine.by_readings())
    upper_parts = (np.eye(3), -skew(arms), driven_above, moved + bent)
    lower_parts = (np.zeros((3, 6)), driven, legs.closure.lower_change(legs, rho, change))
    slopes = (concatenated(upper.shape, *parts)[..., leg, :, :] for parts in (lower_parts, upper_parts))
    return Joints(leg, lower[..., leg, :], upper[..., leg, :], *slopes)


def stacked(closing: Closing) -> NDArray:
    """Concatenate the derivatives (..., M, D) of closure equations by twist, readings and parameters."""
    return np.concatenate([closing.by_twist, closing.by_rho, closing.by_parameter], -1)


def concatenated(shape: tuple[int, ...], *parts: NDArray) -> NDArray:
    """Concatenate derivatives (..., d), each broadcast to the shape, to (*shape, D)."""
    return np.concatenate([np.broadcast_to(part, (*shape, part.shape[-1])) for part in parts], -1)
