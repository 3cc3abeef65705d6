"""Changes from one run of a chain to the next: joint zeros, numbers of links, and effects that both runs found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truing.inference.changes import compare
from truing.report.tables import Row
from truing.runs.comparison.steps import (
    LEVEL,
    NAMES,
    RunStep,
    beyond_chance,
    not_assessed,
    owner,
    shift_without_effects,
)
from truing.simulation.mechanisms.chains.causes import JointOffset
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain
from truing.simulation.mechanisms.chains.tree import TWIST, JointKind, axis_twist
from truing.simulation.reported_numbers import LEAST_REDUCTION

_COMPONENTS = ("dx", "dy", "dz", "turn_x", "turn_y", "turn_z")
_SI = {"mm": 1e-3, "rad": 1.0}
_SAME = 1e-9  # m, rad
_WIDE = 10.0  # prior sigma of an effect, in its values and sigmas


@dataclass(frozen=True)
class _Estimate:
    """Numbers (n,) with covariance (n, n), SI."""

    values: NDArray
    covariance: NDArray


def chain_numbers(extended: ExtendedChain, parameters: pd.DataFrame) -> pd.DataFrame:
    """Return zeros and numbers of links (chain_parameters.parquet), then effects: NAMES, value, sigma and unit."""
    rows: list[tuple[object, ...]] = [
        ("geometry", None, np.nan, _name(r), r.identified, r.sigma, r.unit) for r in parameters.itertuples()
    ]
    for effect in extended.effects:
        if effect.cause.is_persistent:
            reported = effect.cause.reported(effect.values, extended.covariance_of(effect.cause), 0)
            numbers = [number for number in reported if not isinstance(number.value, str)]
            rows += [("effect", owner(effect.cause), None, p.name, p.value, p.sigma, p.unit) for p in numbers]
    return pd.DataFrame(rows, columns=[*NAMES, "value", "sigma", "unit"])


def _name(row: Row) -> str:
    return f"{row.parameter} of joint {row.joint}"


def chain_step(
    before: ExtendedChain, now: ExtendedChain, parameters: pd.DataFrame, parameters_now: pd.DataFrame
) -> RunStep:
    """Return the changes of zeros and links, by the full covariances of both models; tolerances count once.

    ``parameters``: chain_parameters.parquet of each run. A ``joint-offset`` counts with the zero of its joint. Other
    effects widen the differences by the bias that their absence from one model may cause.
    """
    if why := _stated_otherwise(before, now, parameters, parameters_now):
        return not_assessed(why)
    old, new = (_estimate(one, parameters) for one in (before, now))
    tolerance = np.array([t * _SI[u] for t, u in zip(parameters["tolerance"], parameters["unit"], strict=True)])
    prior = tolerance**2 + _WIDE**2 * np.where(_has_offset((before, now), parameters), old.values**2 + new.values**2, 0)
    widened = _bias(before, now, parameters) + _bias(now, before, parameters)
    compared = compare(old.values, old.covariance, new.values, new.covariance, np.diag(1.0 / prior), widened)
    if not len(compared.observable):
        return not_assessed("neither campaign tells more of the machine than its tolerances")
    informed = np.diag(new.covariance) < (1.0 - LEAST_REDUCTION) * prior
    changed, scale = compared.changed(LEVEL), np.array([_SI[unit] for unit in parameters["unit"]])
    names = [("geometry", None, np.nan, _name(r)) for r in parameters.itertuples()]
    rows = pd.DataFrame(names, columns=NAMES).assign(sigma_difference=compared.sigma / scale)
    z = compared.difference / np.where(compared.sigma > 0.0, compared.sigma, np.inf)
    rows["z"] = np.where(informed & (compared.sigma > 0.0), z, np.nan)
    rows["reason"] = [None if known else "not identifiable" for known in informed]
    rows["changed"], rows["change"], rows["sigma_change"], rows["instead"] = changed is None, np.nan, np.nan, None
    if changed is None:
        return RunStep(rows.assign(changed=beyond_chance(rows["z"].to_numpy(float))), rebuilt=True)
    sizes = zip(changed, *compared.sizes(changed), compared.alternatives_to(changed), strict=True)
    for at, size, sigma, rivals in sizes:
        rival_names = ", ".join(names[rival][3] for rival in rivals) or None
        rows.loc[at, ["changed", "change", "sigma_change", "instead"]] = (
            True,
            size / scale[at],
            sigma / scale[at],
            rival_names,
        )
    return RunStep(rows)


def _stated_otherwise(
    before: ExtendedChain, now: ExtendedChain, parameters: pd.DataFrame, parameters_now: pd.DataFrame
) -> str:
    """Return in words why the numbers of two models are not the same ones; empty where they are."""
    nodes = [one.tree.nodes for one in (before, now)]
    if [n.link for n in nodes[0]] != [n.link for n in nodes[1]] or any(
        np.abs(a.t - b.t).max() > _SAME or np.abs(a.R - b.R).max() > _SAME for a, b in zip(*nodes, strict=True)
    ):
        return "their campaign.toml name another nominal geometry"
    keys = ["joint", "parameter", "tolerance"]
    if not parameters[keys].reset_index(drop=True).equals(parameters_now[keys].reset_index(drop=True)):
        return "their campaign.toml name other tolerances"
    if not (parameters["tolerance"] > 0.0).all() or not np.isfinite(parameters["tolerance"]).all():
        return "without [mechanism.tolerance] offset_deg, length_mm and angle_deg, the numbers of links are a choice"
    return ""


def _estimate(extended: ExtendedChain, parameters: pd.DataFrame) -> _Estimate:
    slopes = _slopes(extended, parameters)
    return _Estimate(slopes @ _unknowns(extended), slopes @ extended.covariance @ slopes.T)


def _unknowns(extended: ExtendedChain) -> NDArray:
    """Return twists of the moved nodes, then the effects' whole values, in the order of the covariance."""
    causes_with_known_part = [effect.cause.with_known_part(effect.values) for effect in extended.effects]
    return np.concatenate([extended.twists[extended.moved].ravel(), *causes_with_known_part])


def _slopes(extended: ExtendedChain, parameters: pd.DataFrame) -> NDArray:
    """Return the derivatives (n, G) of the numbers by the unknowns; an offset lies along the joint's own axis."""
    slopes = np.zeros((len(parameters), len(extended.covariance)))
    place_of = {int(node): place for place, node in enumerate(extended.moved)}
    offsets = {
        e.cause.joint: extended.layout[e.cause.key] for e in extended.effects if isinstance(e.cause, JointOffset)
    }
    node_of = {node.joint or node.link: k for k, node in enumerate(extended.tree.nodes)}
    for row, number in enumerate(parameters.itertuples()):
        k = node_of[str(number.joint)]
        if k in place_of:
            slopes[row, TWIST * place_of[k] : TWIST * (place_of[k] + 1)] = _direction(
                extended, k, str(number.parameter)
            )
        if number.parameter == "offset" and number.joint in offsets:
            slopes[row, offsets[str(number.joint)]] = 1.0
    return slopes


def _direction(extended: ExtendedChain, k: int, parameter: str) -> NDArray:
    node = extended.tree.nodes[k]
    if parameter == "offset" and node.kind != JointKind.FIXED:
        return np.asarray(axis_twist(node))
    return np.eye(TWIST)[_COMPONENTS.index(parameter)]


def _has_offset(models: tuple[ExtendedChain, ...], parameters: pd.DataFrame) -> NDArray:
    joints = {cause.joint for model in models for cause in model.causes if isinstance(cause, JointOffset)}
    return ((parameters["parameter"] == "offset") & parameters["joint"].isin(joints)).to_numpy()


def _bias(extended: ExtendedChain, other_model: ExtendedChain, parameters: pd.DataFrame) -> NDArray:
    """Return the shifts of the numbers as a covariance (n, n), if effects that the other model lacks were left out."""
    keys_of_other = {cause.key for cause in other_model.causes}
    lasting = (cause for cause in extended.causes if cause.is_persistent and not isinstance(cause, JointOffset))
    alone = [cause for cause in lasting if cause.key not in keys_of_other]
    slopes = _slopes(extended, parameters)
    linear = np.concatenate([slopes, np.eye(len(extended.covariance))])
    at, count = [np.r_[extended.layout[cause.key]] for cause in alone], len(slopes)
    return shift_without_effects(
        linear @ _unknowns(extended),
        linear @ extended.covariance @ linear.T,
        np.arange(count),
        [count + indices for indices in at],
    )
