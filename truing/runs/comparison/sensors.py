"""Two runs of one force sensor: its compliance with the effects that both have, and the matrix that makes loads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.runs.comparison.mechanisms import effect_rows
from truing.runs.comparison.step import NAMES, Step, beyond_chance, held_at_zero, not_judged
from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.bench.extended_model import ExtendedSensor
from truing.simulation.reported_numbers import TOLD

if TYPE_CHECKING:
    import pandas as pd

_LOADS, _CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz"), ("dx", "dy", "dz", "rx", "ry", "rz")
_ENTRIES = 36
_LEGS = 6


def sensor_numbers(found: ExtendedSensor) -> pd.DataFrame:
    """Return every number of a sensor's model: NAMES, value and sigma in SI, of effects in the tables' units."""
    import pandas as pd

    sigma = np.sqrt(np.diag(found.covariance))
    names = [(f"{channel} {load}", _unit(channel, load)) for channel in _CHANNELS for load in _LOADS]
    rows = [
        ("compliance", None, None, name, value, spread, unit)
        for (name, unit), value, spread in zip(names, found.compliance.ravel(), sigma, strict=False)
    ]
    for effect in found.effects:
        rows += effect_rows(effect.cause, effect.values, sigma[found.layout[effect.cause.key]], _LEGS)
    return pd.DataFrame(rows, columns=[*NAMES, "value", "sigma", "unit"])


def matrix_numbers(table: pd.DataFrame) -> pd.DataFrame:
    """Return the entries of the chosen G_B; empty where none was chosen."""
    own = table[table["chosen"] & (table["matrix"] == "G_B")]
    named = own["row"] + " " + own["column_name"]
    columns = {"group": "G_B", "effect_of": None, "leg": None, "parameter": named}
    return own.assign(**columns)[[*NAMES, "value", "sigma", "unit"]]


def sensor_step(before: ExtendedSensor, now: ExtendedSensor, simulated: NDArray) -> Step:
    """Return what has changed of compliance and common effects; simulated (36,): sigmas known before either campaign.

    The tolerances that both are drawn to are counted as if each campaign had its own: its differences are smaller than
    told, never larger.
    """
    if not np.allclose(before.nominal, now.nominal, rtol=1e-6, atol=0.0):
        return not_judged("their campaign.toml name another sensor, as simulated")
    keys = {c.key for c in before.causes if c.is_persistent} & {c.key for c in now.causes if c.is_persistent}
    (old, sigma_old), (new, sigma_new) = (_common(one, keys) for one in (before, now))
    limit = np.full(len(old), np.inf)
    limit[:_ENTRIES] = np.sqrt(1.0 - TOLD) * simulated
    known = (sigma_old < limit) & (sigma_new < limit)
    scale = _scales(before, keys)
    return _each(_named(before, keys), (new - old) / scale, np.hypot(sigma_old, sigma_new) / scale, known)


def matrix_step(before: pd.DataFrame, now: pd.DataFrame) -> Step:
    """Return which entries of G_B have changed."""
    both = before.merge(now, on=NAMES, suffixes=("_before", "_now"))
    spread = np.hypot(both["sigma_before"].to_numpy(float), both["sigma_now"].to_numpy(float))
    difference = (both["value_now"] - both["value_before"]).to_numpy(float)
    return _each(both[NAMES].to_numpy().tolist(), difference, spread, np.isfinite(spread))


def _each(names: Sequence[Sequence[object]], difference: NDArray, spread: NDArray, known: NDArray) -> Step:
    """Return which of the known numbers (n,) differ by more than chance explains, each by itself.

    The bound is for all of them together, whatever their correlations are.
    """
    import pandas as pd

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
        "reason": [None if told else "not identifiable" for told in known],
    }
    return Step(pd.DataFrame(names, columns=NAMES).assign(**columns))


def _unit(channel: str, load: str) -> str:
    return f"{'m' if channel[0] == 'd' else 'rad'}/{'N' if load[0] == 'f' else '(N m)'}"


def _common(found: ExtendedSensor, keys: set[str]) -> tuple[NDArray, NDArray]:
    """Return compliance and common effects, by key, with their sigmas and what other effects leave open."""
    every = np.concatenate([found.compliance.ravel(), *(effect.values for effect in found.effects)])
    rest = [cause for cause in sorted(found.causes, key=_key) if cause.key not in keys and cause.is_persistent]
    own, others = found.places(_kept(found, keys)), [np.r_[found.layout[cause.key]] for cause in rest]
    spread = found.covariance[np.ix_(own, own)] + held_at_zero(every, found.covariance, own, others)
    return every[own], np.sqrt(np.diag(spread))


def _named(found: ExtendedSensor, keys: set[str]) -> list[tuple[object, ...]]:
    """Return the names of the numbers of ``_common`` in their order."""
    names = (f"{channel} {load}" for channel in _CHANNELS for load in _LOADS)
    rows: list[tuple[object, ...]] = [("compliance", None, None, name) for name in names]
    for cause in _kept(found, keys):
        none = np.zeros(len(cause.parameters(_LEGS)))
        rows += [row[:4] for row in effect_rows(cause, none, none, _LEGS)]
    return rows


def _scales(found: ExtendedSensor, keys: set[str]) -> NDArray:
    """Return the unit of each number of ``_common`` in SI."""
    si = [p.si for cause in _kept(found, keys) for p in cause.parameters(_LEGS)]
    return np.concatenate([np.ones(_ENTRIES), np.array(si, float)])


def _kept(found: ExtendedSensor, keys: set[str]) -> list[ReadingCause]:
    return sorted((cause for cause in found.causes if cause.key in keys), key=_key)


def _key(cause: ReadingCause) -> str:
    return cause.key
