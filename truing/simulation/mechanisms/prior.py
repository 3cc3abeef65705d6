"""Results of a prior campaign of the same mechanism as prior knowledge for the next one.

If both campaigns use the same survey, its information on the attachments enters only once. Otherwise the frames of base
and platform differ by the noise of the surveys that define them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import rigid_motions, skew
from truing.simulation.mechanisms.extended_model import LEAST_FRAME, ExtendedModel, survey_noise
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.point_causes import PointCause
from truing.simulation.prior_campaign import (
    CampaignPrior,
    SharedUnknowns,
    block_diagonal,
    centred,
    clipped,
    marginal,
    persistent_causes,
)
from truing.simulation.targets import BASE, FREE_LENGTH_M, PLATFORM

_SAME_M = 1e-9
_GEOMETRY = ("a", "b", "u", "l")


def mechanism_prior(
    extended: ExtendedModel, model: MechanismModel, common: tuple[PointCause, ...] | None = None
) -> CampaignPrior[PointCause]:
    """Return the prior that an identified model gives for the model of the next campaign.

    Effects that the next campaign cannot predict, because a column is missing, are omitted; ``common``: effects of
    both.
    """
    old, causes = extended.model, common
    if causes is None:
        drives = {f"rho{leg}_mm" for leg in range(1, model.part_count + 1)}
        causes = persistent_causes(old.causes, model.part_count, model.conditions.covariates, drives)
    wider = model.with_causes(causes)
    names = [name for name in _GEOMETRY if name in old.layout and name in wider.layout]
    names += [cause.key for cause in causes]
    parts = tuple(SharedUnknowns(name, np.broadcast_to(wider.scale_of(name), _size(old, name))) for name in names)
    bridge = _bridge(old, wider, names)
    old_own, others = _split(old, names)
    information = clipped(np.linalg.inv(extended.covariance) - np.eye(len(extended.shared)))
    information = marginal(information + np.diag(np.isin(np.arange(len(information)), others).astype(float)), others)[
        np.ix_(old_own, old_own)
    ]
    back, nominal = np.linalg.inv(bridge), _offset(old, wider, names)
    estimate = (
        bridge @ extended.shared[old_own] + nominal,
        bridge @ extended.covariance[np.ix_(old_own, old_own)] @ bridge.T,
    )
    prior = CampaignPrior.of(causes, parts, estimate, clipped(back.T @ information @ back), back.T @ back, nominal)
    return _by_survey(prior, extended, wider)


def _size(model: MechanismModel, name: str) -> int:
    part = model.layout[name]
    return part.stop - part.start


def _split(model: MechanismModel, names: Sequence[str]) -> tuple[NDArray, NDArray]:
    """Return the indices of the named parts among a model's unknowns, in that order, and those of all others."""
    slices = [model.layout[name] for name in names]
    columns = np.concatenate([np.arange(part.start, part.stop) for part in slices]) if slices else np.zeros(0, int)
    return columns, np.setdiff1d(np.arange(model.shared_size), columns)


def _bridge(old: MechanismModel, new: MechanismModel, names: Sequence[str]) -> NDArray:
    """Return the matrix (n, n) from the prior model's unknowns to the next one's: scales, and axes of the tilts."""
    blocks = []
    for name in names:
        size = _size(old, name)
        ratio = np.broadcast_to(old.scale_of(name), size) / np.broadcast_to(new.scale_of(name), size)
        turn = np.eye(size)
        if name == "u":
            product = np.einsum("lim,lin->lmn", new.transverse_directions, old.transverse_directions)
            turn = np.einsum("lmn,lk->lmkn", product, np.eye(len(product))).reshape(size, size)
        blocks.append(turn * ratio)
    return block_diagonal(*blocks)


def _offset(old: MechanismModel, new: MechanismModel, names: Sequence[str]) -> NDArray:
    """Return the difference of the nominal values in units of the next model's unknowns."""
    away = new.unknowns(old.nominal, {cause.key: np.zeros_like(new.effect_sigma(cause)) for cause in new.causes})
    new_own, _ = _split(new, names)
    return away[new_own]


def _by_survey(
    prior: CampaignPrior[PointCause], extended: ExtendedModel, model: MechanismModel
) -> CampaignPrior[PointCause]:
    """Remove information that a common survey would give twice, or add the covariance between two surveys."""
    if _same_survey(extended, model):
        away, slopes = model.survey_rows(np.zeros(model.shared_size))
        rows = slopes[:, prior.places(model)]
        common, information = rows.T @ rows, clipped(prior.information - rows.T @ rows)
        pull = prior.information @ prior.middle - rows.T @ away
        return replace(prior, shared=prior.shared + common, information=information, middle=centred(information, pull))
    moves, spread = _frames(prior, extended, model)
    if not len(spread):
        return prior
    carried = moves.T @ prior.information
    inner = np.linalg.inv(np.linalg.inv(spread) + carried @ moves)
    return replace(
        prior,
        frames=moves @ spread @ moves.T,
        information=clipped(prior.information - carried.T @ inner @ carried),
    )


def _same_survey(extended: ExtendedModel, model: MechanismModel) -> bool:
    """True if both surveys have the same targets of base and platform at the same positions."""
    before, now = (_attached_positions(machine_model) for machine_model in (extended.model, model))
    return before.keys() == now.keys() and all(
        np.abs(before[key] - point).max() < _SAME_M for key, point in now.items()
    )


def _attached_positions(model: MechanismModel) -> dict[tuple[int, str], NDArray]:
    targets = model.targets
    indices = np.flatnonzero(np.isin(targets.body, (BASE, PLATFORM)))
    return {
        (int(targets.body[k]), targets.names[k] if targets.names else str(k)): model.known.shape[k] for k in indices
    }


def _frames(
    prior: CampaignPrior[PointCause], extended: ExtendedModel, model: MechanismModel
) -> tuple[NDArray, NDArray]:
    """Return the derivative (n, 12) of the numbers by motions of the two frames, and the motions' covariance (12, 12),
    m, rad.

    Empty if a frame is defined by the attachments themselves.
    """
    covariances = []
    for body in (BASE, PLATFORM):
        total = np.zeros((6, 6))
        for machine_model, sigma in ((extended.model, extended.survey_sigma), (model, survey_noise(model))):
            on_body = (machine_model.targets.body == body) & (machine_model.targets.leg < 0)
            if on_body.sum() < LEAST_FRAME:
                return np.zeros((len(prior.mean), 0)), np.zeros((0, 0))
            total += sigma[on_body].mean() ** 2 * np.linalg.inv(_rigid_information(machine_model.known.shape[on_body]))
        covariances.append(total)
    spread = np.zeros((12, 12))
    spread[:6, :6], spread[6:, 6:] = covariances
    # Least variance of a frame: the covariance of an exact survey could not be inverted.
    spread += np.eye(12) * (1e-6 * FREE_LENGTH_M) ** 2
    return _moved_by_frames(prior, model), spread


def _rigid_information(points: NDArray) -> NDArray:
    rows = rigid_motions(points)
    return np.asarray(np.einsum("nij,nik->jk", rows, rows))


def _moved_by_frames(prior: CampaignPrior[PointCause], model: MechanismModel) -> NDArray:
    """Return the derivative of joints and directions by a motion (t, theta) of the base's frame, then of the
    platform's."""
    legs, across = model.nominal, model.transverse_directions
    turned = -skew(legs.u)
    blocks = {
        "a": (0, rigid_motions(legs.a)),
        "b": (6, rigid_motions(legs.b)),
        "u": (0, np.einsum("lim,lij->lmj", across, np.concatenate([np.zeros_like(turned), turned], -1))),
    }
    shifts = []
    for part in prior.parts:
        rows = np.zeros((len(part.scale), 12))
        if part.name in blocks:
            first, moved = blocks[part.name]
            rows[:, first : first + 6] = moved.reshape(-1, 6)
        shifts.append(rows / part.scale[:, None])
    return np.concatenate(shifts)
