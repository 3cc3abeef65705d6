"""Two extended models of one mechanism: geometry and common effects, by the judge of a next campaign."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.inference.changes import compare
from truing.runs.comparison.step import LEVEL, NAMES, Step, beyond_chance, held_at_zero, not_judged
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.extended_model import ExtendedModel, identified_geometry, name_and_leg
from truing.simulation.mechanisms.model import PointModel
from truing.simulation.mechanisms.prior import mechanism_prior
from truing.simulation.reported_numbers import TOLD, Told, figures, told_numbers
from truing.simulation.targets import shape_unknowns

if TYPE_CHECKING:
    import pandas as pd

_SAME_M = 1e-9


def mechanism_numbers(found: ExtendedModel) -> pd.DataFrame:
    """Return every number of a model: NAMES, value and sigma in the tables' units."""
    import pandas as pd

    model, sigma = found.model, np.sqrt(np.diag(found.covariance))
    geometry = identified_geometry(model, found.shared, found.covariance)
    rows = [
        ("geometry", None, entry.leg + 1, entry.name, value / entry.si, spread / entry.si, entry.unit)
        for entry, value, spread in zip(geometry.parameters, geometry.values, geometry.sigma, strict=True)
    ]
    for effect in model.effects(found.shared):
        spreads = sigma[model.layout[effect.cause.key]] * model.effect_sigma(effect.cause)
        rows += effect_rows(effect.cause, effect.values, spreads, model.part_count)
    return pd.DataFrame(rows, columns=[*NAMES, "value", "sigma", "unit"])


def effect_rows(cause: Cause, values: NDArray, sigmas: NDArray, legs: int) -> list[tuple[Any, ...]]:
    """Return the parameters of an effect as rows: values and sigmas (P,), SI."""
    rows = []
    for p, value, sigma in zip(cause.parameters(legs), values, sigmas, strict=True):
        name, leg = name_and_leg(p.name)
        rows.append(("effect", owner(cause), leg, name, value / p.si, sigma / p.si, p.unit))
    return rows


def owner(cause: Cause) -> str:
    """Return what the tables call an effect."""
    return f"{cause.id} {cause.subject}".strip()


def mechanism_step(before: ExtendedModel, now: ExtendedModel) -> Step:
    """Return what has changed between two models of one mechanism, each with its whole covariance.

    Tolerances draw both the same way, and so does a survey that both rest on; surveys of their own define frames of
    their own.
    """
    if stated := _stated_otherwise(before.model, now.model):
        return not_judged(stated)
    own_keys, lasting = ({c.key for c in one.model.causes if c.is_persistent} for one in (now, before))
    common = tuple(c for c in before.model.causes if c.key in own_keys & lasting)
    earlier = mechanism_prior(before, _surveyed(now), common)
    then_at, now_at = (earlier.places(one.model) for one in (before, now))
    apart = earlier.frames + sum(
        held_at_zero(one.shared, one.covariance, own, _of_others(one.model, common))
        for one, own in ((before, then_at), (now, now_at))
    )
    value, covariance = now.shared[now_at], now.covariance[np.ix_(now_at, now_at)]
    found = compare(earlier.mean, earlier.covariance, value, covariance, earlier.shared, apart)
    told = told_numbers(earlier, now.model, now.shared, now.covariance)
    columns = {**told.columns, **figures(earlier, told, found, value, covariance, LEVEL)}
    if len(found.told) == 0:
        return not_judged("neither campaign tells more of the machine than its tolerances")
    known = _known(told, earlier.covariance, np.linalg.inv(earlier.shared)) & ~np.isnan(columns["z"])
    return _step(columns, known)


def _step(columns: dict[str, Any], known: NDArray) -> Step:
    import pandas as pd

    rows = pd.DataFrame(columns)
    rebuilt = bool(rows["changed"].all())
    rows = rows.reindex(columns=[*dict.fromkeys([*rows.columns, "change", "sigma_change", "instead"])])
    rows["group"] = np.where(rows["effect_of"].isna(), "geometry", "effect")
    rows["z"] = rows["z"].where(known)
    if rebuilt:
        rows["changed"] = beyond_chance(rows["z"].to_numpy(float))
    rows["reason"] = [None if told else "not identifiable" for told in known]
    return Step(rows.drop(columns=["before", "sigma_before", "now", "sigma_now", "unit"]), rebuilt=rebuilt)


def _known(told: Told, covariance: NDArray, prior: NDArray) -> NDArray:
    """Return which rows (R,) an estimate tells more of than what was known before."""
    by = told.by_numbers
    return np.diag(by @ covariance @ by.T) < (1.0 - TOLD) * np.diag(by @ prior @ by.T)


def _of_others(model: PointModel, common: tuple[Cause, ...]) -> list[NDArray]:
    """Return where the parameters of lasting effects stand that the other model does not have."""
    keys = {cause.key for cause in common}
    own = [model.layout[cause.key] for cause in model.causes if cause.is_persistent and cause.key not in keys]
    return [np.arange(part.start, part.stop) for part in own]


def _stated_otherwise(before: PointModel, now: PointModel) -> str:
    """Return what campaign.toml of the two says differently; empty where both start from the same drawing."""
    old, new = before.nominal, now.nominal
    for name in ("a", "b", "u", "l", "rho0"):
        if np.abs(getattr(old, name) - getattr(new, name)).max() > _SAME_M:
            return "their campaign.toml name another nominal geometry"
    if before.known.geometry != now.known.geometry or before.known.open_geometry != now.known.open_geometry:
        return "their campaign.toml name other tolerances"
    return ""


def _surveyed(found: ExtendedModel) -> PointModel:
    """Return the model with the noise of its survey, which its text holds as one sigma per target."""
    model, sigma = found.model, found.survey_sigma
    if not len(sigma) or sigma.min() <= 0.0:
        return model
    survey = shape_unknowns(model.targets, model.known.shape, sigma[:, None, None] ** 2 * np.eye(3))
    return replace(model, known=replace(model.known, survey=survey))
