"""Shifts of the attachments of a platform along z, and their models by the actuators (telescope report, eq. 1-4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.deformation.correlated_shifts import CorrelatedShifts, correlated_shifts
from truing.estimation.response import ResponseFit, fit_models, fit_response, keep_consistent
from truing.estimation.response_structure import (
    gain_p_value,
)
from truing.estimation.rigid_poses.frame import residual_covariance
from truing.estimation.rigid_poses.joint_frames import FramedPoints
from truing.estimation.rigid_poses.points import PosePoints, SurveyPoints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shifts:
    """Shift of each leg's attachment along z of the platform.

    shift (B, L) in m, NaN where not seen; across (B, L, 2) the same along x and y, which gross errors show;
    noise (B, L, L) of the measurement, own (B, L) variance of what the attachment's own targets bring to it, survey
    (L, L) of the survey, and of cameras and bars, which all poses share; attachments (L, 3);
    modulo_plane: the frame was fitted to the attachments themselves; together: where points have errors in common.
    """

    shift: Array
    across: Array
    noise: Array
    own: Array
    survey: Array
    attachments: Array
    modulo_plane: bool
    together: CorrelatedShifts | None


@dataclass(frozen=True)
class AttachmentModels:
    """Fits of the shifts by model: none, linear, matrix, as far as anything of them is determined.

    determined (L,) by model: legs whose coefficients are told; gains: p-value of each larger model over the next
    smaller one; held (V, L) by model: what is left at poses that are held out; rejected, kept (B, L): gross errors, and
    shifts in m without these, NaN elsewhere; fitted (B,): poses that models were fitted to.
    """

    fits: Mapping[str, ResponseFit]
    determined: Mapping[str, NDArray[np.bool_]]
    gains: Mapping[str, float]
    held: Mapping[str, Array]
    rejected: NDArray[np.bool_]
    kept: Array
    fitted: NDArray[np.bool_]


def attachment_models(drive: Array, shifts: Shifts, heldout: NDArray[np.bool_]) -> AttachmentModels:
    """Return the models of the shifts by drives (B, L), m (telescope report, eq. 1-4); heldout (B,) poses test them."""
    fitted = ~heldout
    prior = {"offset_cov": shifts.survey}
    good = np.isfinite(shifts.shift) & _consistent_attachments(drive, shifts, fitted)
    kept = np.where(good, shifts.shift, np.nan)
    fits = fit_models(drive[fitted], kept[fitted], shifts.noise[fitted], ("none", "linear", "matrix"), **prior)
    # All three with the same weights, as an F test asks.
    gains = {
        "linear": gain_p_value(fits["none"], fits["linear"]),
        "matrix": gain_p_value(fits["linear"], fits["matrix"]),
    }
    fits["linear"] = _leg_by_leg(drive[fitted], kept[fitted], shifts.noise[fitted])
    told = _determined(drive[fitted], kept[fitted])
    fits = {name: fit for name, fit in fits.items() if told[name].any()}
    held = {name: kept[heldout] - fit.offset.mean(0) - fit.predict(drive[heldout]) for name, fit in fits.items()}
    return AttachmentModels(fits, told, gains, held, np.isfinite(shifts.shift) & ~good, kept, fitted)


def _determined(drive: Array, shift: Array) -> dict[str, NDArray[np.bool_]]:
    """(L,) legs whose coefficients the shifts (B, L) at drives (B, L) determine, by model.

    The others would be the shortest of many solutions with a standard deviation that says nothing.
    """
    seen = [drive[rows] for rows in np.isfinite(shift).T]
    moved = [len(u) > 1 and bool(np.ptp(u[:, leg]) > 0.0) for leg, u in enumerate(seen)]
    spanned = [len(u) >= u.shape[1] and np.linalg.matrix_rank(u) == u.shape[1] for u in seen]
    return {"none": np.ones(len(seen), bool), "linear": np.array(moved), "matrix": np.array(spanned)}


def _leg_by_leg(drive: Array, shift: Array, noise: Array) -> ResponseFit:
    """The linear model as eq. 1 has it, each leg regressed by itself with an offset of its own.

    Where the other actuators move an attachment too, the model is wrong; weights that carry one leg's misfit into
    another's coefficient, or an offset held to the survey, would then answer another question.
    """
    alone = noise * np.eye(noise.shape[1])
    return fit_response(drive, shift, alone, form="linear")


def attachment_shifts(
    survey: SurveyPoints,
    observed: PosePoints,
    residual: Array,
    used: NDArray[np.bool_],
    rotation: Array,
    framed: FramedPoints | None,
    n_legs: int,
) -> Shifts:
    """Return the shifts of the attachments from residuals (B, T, 3) of the platform's targets, m, in its own axes.

    used (B, T): targets that made the frame; rotation (B, 3, 3) from the platform to the measurement; framed: what
    points have in common, None where they are independent.
    """
    seen = np.isfinite(residual[:, :, 2])
    noise = np.einsum("bji,btjk,bkl->btil", rotation, observed.cov, rotation)
    per_leg = _leg_average(survey, seen, noise, n_legs)
    measured = _along_z(residual_covariance(survey.points, noise, used, seen))
    surveyed = _along_z(_survey_covariance(survey, used))
    shift = np.einsum("blt,bta->bla", per_leg, np.nan_to_num(residual))
    shift[~per_leg.any(axis=2)] = np.nan
    typical = _typical_average(survey, n_legs)
    of_points, shared = np.einsum("blt,bts,bms->blm", per_leg, measured, per_leg), typical @ surveyed @ typical.T
    together = None if framed is None else correlated_shifts(framed, per_leg)
    if together is not None:  # a pose without a joint fit keeps what its points say one by one
        of_points, shared = np.where(together.there[:, None, None], together.noise, of_points), together.shared
    return Shifts(
        shift[:, :, 2],
        shift[:, :, :2],
        of_points,
        np.einsum("blt,bt->bl", per_leg**2, noise[:, :, 2, 2]),
        shared,
        typical @ survey.points,
        bool((used & (survey.leg > 0)).any()),
        together,
    )


def _consistent_attachments(drive: Array, shifts: Shifts, fitted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(B, L) attachments whose shift, along z and across it, agrees with a matrix model of its own direction.

    The noise along z stands for that across: a gross error is many times either.
    """
    directions = (shifts.shift, shifts.across[:, :, 0], shifts.across[:, :, 1])
    kept = [keep_consistent(drive, y, shifts.noise, offset_cov=shifts.survey, fitted=fitted) for y in directions]
    return np.logical_and.reduce(kept)


def _along_z(covariance: Array) -> Array:
    return covariance[..., 2::3, 2::3]


def _survey_covariance(survey: SurveyPoints, used: NDArray[np.bool_]) -> Array:
    """(3T, 3T) covariance that the survey's own noise leaves in every pose's residuals alike."""
    usual = used.mean(axis=0) > 0.5
    everywhere = np.ones((1, len(survey.targets)), bool)
    return residual_covariance(survey.points, survey.cov[None], usual[None], everywhere)[0]


def _leg_average(survey: SurveyPoints, seen: NDArray[np.bool_], noise: Array, n_legs: int) -> Array:
    """(B, L, T) weights that average the targets of each attachment, by their noise along z; zero rows where
    none was seen."""
    member = survey.leg[None, :] == np.arange(1, n_legs + 1)[:, None]
    variance = np.where(noise[:, :, 2, 2] > 0.0, noise[:, :, 2, 2], np.inf)
    weight = member[None] * np.where(seen, 1.0 / variance, 0.0)[:, None, :]
    total = weight.sum(axis=2, keepdims=True)
    return np.divide(weight, total, out=np.zeros_like(weight), where=total > 0.0)


def _typical_average(survey: SurveyPoints, n_legs: int) -> Array:
    member = (survey.leg[None, :] == np.arange(1, n_legs + 1)[:, None]).astype(float)
    return member / np.maximum(member.sum(axis=1, keepdims=True), 1.0)
