"""Changes from one run to the next in the numbers that both have, or the reason that excludes a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.inference.changes import compare
from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.bench.extended_model import ExtendedSensor
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.extended_model import ExtendedModel, identified_geometry, name_and_leg
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.prior import mechanism_prior
from truing.simulation.reported_numbers import LEAST_REDUCTION, ReportedNumbers, figures, reported_numbers
from truing.simulation.targets import shape_unknowns

# Rate of comparisons that report a change although nothing changed.
FALSE_ALARM = 0.05
# Each of two tests gets half of it: for a mechanism, single numbers and all together; for a sensor, compliance and
# matrix.
LEVEL = FALSE_ALARM / 2.0
NAMES = ["group", "effect_of", "leg", "parameter"]

_SAME_M = 1e-9

_ENTRIES = 36
_LEGS = 6


@dataclass(frozen=True)
class RunStep:
    """Rows by NAMES with sigma_difference, z, changed, change, sigma_change, instead and reason.

    Empty where nothing could be compared, with the reason in ``why``. ``rebuilt``: too many numbers changed to name
    them one by one.
    """

    rows: pd.DataFrame
    why: str = ""
    rebuilt: bool = False


def not_assessed(why: str) -> RunStep:
    """Return the step between two runs whose numbers cannot be compared."""
    return RunStep(pd.DataFrame(columns=[*NAMES, "z", "changed"]), why)


def shift_without_effects(shared: NDArray, covariance: NDArray, geometry: NDArray, effects: list[NDArray]) -> NDArray:
    """Return the shifts of the numbers ``geometry`` (n,) if each effect were left out, as a covariance (n, n).

    shared (G,) with covariance (G, G); effects: the indices of each one's parameters. An effect that one campaign found
    may be present but missing in the other's model, whose numbers are then biased by this much.
    """
    spread = np.zeros((len(geometry), len(geometry)))
    for columns in effects:
        gain = np.linalg.solve(covariance[np.ix_(columns, columns)], covariance[np.ix_(columns, geometry)])
        moved = gain.T @ shared[columns]
        spread += np.outer(moved, moved)
    return spread


def beyond_chance(z: NDArray) -> NDArray:
    """Return True for differences over their sigmas (n,), NaN where not assessed, that are significant.

    Each number is tested by itself at a familywise level, valid for any correlations.
    """
    from scipy.special import ndtr

    assessed = np.isfinite(z)
    return assessed & (2.0 * ndtr(-np.abs(np.where(assessed, z, 0.0))) * max(int(assessed.sum()), 1) < LEVEL)


def mechanism_numbers(extended: ExtendedModel) -> pd.DataFrame:
    """Return all numbers of a model: NAMES, value and sigma in the tables' units."""
    model, sigma = extended.model, np.sqrt(np.diag(extended.covariance))
    geometry = identified_geometry(model, extended.shared, extended.covariance)
    rows = [
        ("geometry", None, entry.leg + 1, entry.name, value / entry.si, spread / entry.si, entry.unit)
        for entry, value, spread in zip(geometry.parameters, geometry.values, geometry.sigma, strict=True)
    ]
    for effect in model.effects(extended.shared):
        spreads = sigma[model.layout[effect.cause.key]] * model.effect_sigma(effect.cause)
        rows += _effect_rows(effect.cause, effect.values, spreads, model.part_count)
    return pd.DataFrame(rows, columns=[*NAMES, "value", "sigma", "unit"])


def _effect_rows(cause: Cause, values: NDArray, sigmas: NDArray, legs: int) -> list[tuple[Any, ...]]:
    """Return the parameters of an effect as rows: values and sigmas (P,), SI."""
    rows = []
    for p, value, sigma in zip(cause.parameters(legs), values, sigmas, strict=True):
        name, leg = name_and_leg(p.name)
        rows.append(("effect", owner(cause), leg, name, value / p.si, sigma / p.si, p.unit))
    return rows


def owner(cause: Cause) -> str:
    """Return the name of an effect in the tables."""
    return f"{cause.id} {cause.subject}".strip()


def mechanism_step(before: ExtendedModel, now: ExtendedModel) -> RunStep:
    """Return the changes between two models of one mechanism, by their full covariances.

    Both estimates are drawn to the same tolerances, and to a survey if both rest on the same one; separate surveys
    define separate frames.
    """
    if stated := _stated_otherwise(before.model, now.model):
        return not_assessed(stated)
    own_keys, persistent = ({c.key for c in one.model.causes if c.is_persistent} for one in (now, before))
    common = tuple(c for c in before.model.causes if c.key in own_keys & persistent)
    prior = mechanism_prior(before, _surveyed(now), common)
    then_at, now_at = (prior.places(one.model) for one in (before, now))
    total = prior.frames + sum(
        shift_without_effects(one.shared, one.covariance, indices, _unshared_effects(one.model, common))
        for one, indices in ((before, then_at), (now, now_at))
    )
    value, covariance = now.shared[now_at], now.covariance[np.ix_(now_at, now_at)]
    compared = compare(prior.mean, prior.covariance, value, covariance, prior.shared, total)
    reported = reported_numbers(prior, now.model, now.shared, now.covariance)
    columns: dict[str, Any] = {**reported.columns, **figures(prior, reported, compared, value, covariance, LEVEL)}
    if len(compared.observable) == 0:
        return not_assessed("neither campaign determines the machine better than its tolerances")
    known = _is_informed(reported, prior.covariance, np.linalg.inv(prior.shared)) & ~np.isnan(columns["z"])
    return _step(columns, known)


def _step(columns: dict[str, object], known: NDArray) -> RunStep:
    rows = pd.DataFrame(columns)
    rebuilt = bool(rows["changed"].all())
    rows = rows.reindex(columns=[*dict.fromkeys([*rows.columns, "change", "sigma_change", "instead"])])
    rows["group"] = np.where(rows["effect_of"].isna(), "geometry", "effect")
    rows["z"] = rows["z"].where(known)
    if rebuilt:
        rows["changed"] = beyond_chance(rows["z"].to_numpy(float))
    rows["reason"] = [None if reported else "not identifiable" for reported in known]
    return RunStep(rows.drop(columns=["before", "sigma_before", "now", "sigma_now", "unit"]), rebuilt=rebuilt)


def _is_informed(reported: ReportedNumbers, covariance: NDArray, prior: NDArray) -> NDArray:
    """Return True for rows (R,) on which an estimate holds more information than the prior."""
    by = reported.by_numbers
    return np.diag(by @ covariance @ by.T) < (1.0 - LEAST_REDUCTION) * np.diag(by @ prior @ by.T)


def _unshared_effects(model: MechanismModel, common: tuple[Cause, ...]) -> list[NDArray]:
    """Return the places of persistent effects that the other model does not have."""
    keys = {cause.key for cause in common}
    places_of_causes = [
        model.layout[cause.key] for cause in model.causes if cause.is_persistent and cause.key not in keys
    ]
    return [np.arange(part.start, part.stop) for part in places_of_causes]


def _stated_otherwise(before: MechanismModel, now: MechanismModel) -> str:
    """Return in words the differences of campaign.toml; empty where both start from the same nominal machine."""
    old, new = before.nominal, now.nominal
    for name in ("a", "b", "u", "l", "rho0"):
        if np.abs(getattr(old, name) - getattr(new, name)).max() > _SAME_M:
            return "their campaign.toml name another nominal geometry"
    if before.known.geometry != now.known.geometry or before.known.open_geometry != now.known.open_geometry:
        return "their campaign.toml name other tolerances"
    return ""


def _surveyed(extended: ExtendedModel) -> MechanismModel:
    """Return the model with the noise of its survey, which its text holds as one sigma per target."""
    model, sigma = extended.model, extended.survey_sigma
    if not len(sigma) or sigma.min() <= 0.0:
        return model
    survey = shape_unknowns(model.targets, model.known.shape, sigma[:, None, None] ** 2 * np.eye(3))
    return replace(model, known=replace(model.known, survey=survey))


def sensor_numbers(extended: ExtendedSensor) -> pd.DataFrame:
    """Return all numbers of a sensor's model: NAMES, value and sigma in SI, those of effects in the tables' units."""
    sigma = np.sqrt(np.diag(extended.covariance))
    names = [(f"{channel} {load}", _unit(channel, load)) for channel in CHANNELS for load in LOADS]
    rows = [
        ("compliance", None, None, name, value, spread, unit)
        for (name, unit), value, spread in zip(names, extended.compliance.ravel(), sigma, strict=False)
    ]
    for effect in extended.effects:
        rows += _effect_rows(effect.cause, effect.values, sigma[extended.layout[effect.cause.key]], _LEGS)
    return pd.DataFrame(rows, columns=[*NAMES, "value", "sigma", "unit"])


def matrix_numbers(table: pd.DataFrame) -> pd.DataFrame:
    """Return the entries of the chosen G_B; empty where none was chosen."""
    chosen_rows = table[table["chosen"] & (table["matrix"] == "G_B")]
    named = chosen_rows["row"] + " " + chosen_rows["column_name"]
    columns = {"group": "G_B", "effect_of": None, "leg": None, "parameter": named}
    return chosen_rows.assign(**columns)[[*NAMES, "value", "sigma", "unit"]]


def sensor_step(before: ExtendedSensor, now: ExtendedSensor, simulated: NDArray) -> RunStep:
    """Return the changes of compliance and common effects; simulated (36,): prior sigmas of both campaigns.

    The shared prior counts as if each campaign had its own, so the stated uncertainty of differences is an upper bound.
    """
    if not np.allclose(before.nominal, now.nominal, rtol=1e-6, atol=0.0):
        return not_assessed("their campaign.toml name another sensor, as simulated")
    keys = {c.key for c in before.causes if c.is_persistent} & {c.key for c in now.causes if c.is_persistent}
    (old, sigma_old), (new, sigma_new) = (_common(one, keys) for one in (before, now))
    limit = np.full(len(old), np.inf)
    limit[:_ENTRIES] = np.sqrt(1.0 - LEAST_REDUCTION) * simulated
    known = (sigma_old < limit) & (sigma_new < limit)
    scale = _scales(before, keys)
    return tested_changes(
        _number_names(before, keys), (new - old) / scale, np.hypot(sigma_old, sigma_new) / scale, known
    )


def matrix_step(before: pd.DataFrame, now: pd.DataFrame) -> RunStep:
    """Return the changes of the entries of G_B."""
    both = before.merge(now, on=NAMES, suffixes=("_before", "_now"))
    spread = np.hypot(both["sigma_before"].to_numpy(float), both["sigma_now"].to_numpy(float))
    difference = (both["value_now"] - both["value_before"]).to_numpy(float)
    return tested_changes(both[NAMES].to_numpy().tolist(), difference, spread, np.isfinite(spread))


def tested_changes(names: Sequence[Sequence[object]], difference: NDArray, spread: NDArray, known: NDArray) -> RunStep:
    """Return the significant changes of the known numbers (n,), each tested by itself. The level is familywise, valid
    for any correlations."""
    known = known & (spread > 0.0)
    z = np.where(known, difference / np.where(known, spread, 1.0), np.nan)
    changed = beyond_chance(z)
    columns = {
        "sigma_difference": spread,
        "z": z,
        "changed": changed,
        "change": np.where(changed, difference, np.nan),
        "sigma_change": np.where(changed, spread, np.nan),
        "instead": None,
        "reason": [None if reported else "not identifiable" for reported in known],
    }
    return RunStep(pd.DataFrame(names, columns=NAMES).assign(**columns))


def _unit(channel: str, load: str) -> str:
    return f"{'m' if channel[0] == 'd' else 'rad'}/{'N' if load[0] == 'f' else '(N m)'}"


def _common(extended: ExtendedSensor, keys: set[str]) -> tuple[NDArray, NDArray]:
    """Return compliance and common effects, by key, with sigmas that include the possible bias by other effects."""
    every = np.concatenate([extended.compliance.ravel(), *(effect.values for effect in extended.effects)])
    other_causes = [
        cause for cause in sorted(extended.causes, key=_key) if cause.key not in keys and cause.is_persistent
    ]
    indices, other_indices = (
        extended.places(_common_causes(extended, keys)),
        [np.r_[extended.layout[cause.key]] for cause in other_causes],
    )
    spread = extended.covariance[np.ix_(indices, indices)] + shift_without_effects(
        every, extended.covariance, indices, other_indices
    )
    return every[indices], np.sqrt(np.diag(spread))


def _number_names(extended: ExtendedSensor, keys: set[str]) -> list[tuple[object, ...]]:
    """Return the names of the numbers of ``_common`` in their order."""
    names = (f"{channel} {load}" for channel in CHANNELS for load in LOADS)
    rows: list[tuple[object, ...]] = [("compliance", None, None, name) for name in names]
    for cause in _common_causes(extended, keys):
        none = np.zeros(len(cause.parameters(_LEGS)))
        rows += [row[:4] for row in _effect_rows(cause, none, none, _LEGS)]
    return rows


def _scales(extended: ExtendedSensor, keys: set[str]) -> NDArray:
    """Return the unit of each number of ``_common`` in SI."""
    si = [p.si for cause in _common_causes(extended, keys) for p in cause.parameters(_LEGS)]
    return np.concatenate([np.ones(_ENTRIES), np.array(si, float)])


def _common_causes(extended: ExtendedSensor, keys: set[str]) -> list[ReadingCause]:
    return sorted((cause for cause in extended.causes if cause.key in keys), key=_key)


def _key(cause: ReadingCause) -> str:
    return cause.key
