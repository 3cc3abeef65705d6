"""Changes from one run of a chain to the next: joint zeros, numbers of links, and effects that both runs found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
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
from truing.simulation.mechanisms.chains.causes import ChainCause, JointOffset
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain
from truing.simulation.mechanisms.chains.link_components import along_components
from truing.simulation.mechanisms.chains.tree import TWIST, JointKind, axis_twist
from truing.simulation.reported_numbers import LEAST_REDUCTION
from truing.simulation.targets import FREE_ANGLE_RAD, FREE_LENGTH_M

_COMPONENTS = ("dx", "dy", "dz", "turn_x", "turn_y", "turn_z")
_SI = {"mm": 1e-3, "rad": 1.0}
_SAME = 1e-9  # m, rad
_NO_VARIANCE = 1e-13  # of a direction, relative to the wide prior
_WIDE = 10.0  # prior sigma of an effect, in its values and sigmas
# Settings of a cause that scale its fit, and leave the meaning of its parameters.
_OF_THE_FIT = {"load", "loads", "distances", "start", "first", "beside"}
_DEPENDENT = "follows from the other numbers"
_ANOTHER_FORM = "another form of the effect in the run before"
_WITH_ZERO = "counts with the zero of its joint"


@dataclass(frozen=True)
class _Estimate:
    """Numbers (n,) with covariance (n, n), SI."""

    values: NDArray
    covariance: NDArray


@dataclass(frozen=True)
class _Numbers:
    """Numbers of two models of one chain that are compared: rows of chain_parameters.parquet, then sizes of effects.

    ``prior`` (m, m): covariance of the rows' numbers before either campaign, SI. ``effects``: causes of the earlier
    model, which the later one holds in the same form.
    """

    parameters: pd.DataFrame
    prior: NDArray
    effects: tuple[ChainCause, ...]

    @property
    def names(self) -> list[tuple[object, ...]]:
        """Names by NAMES."""
        sizes = ((owner(cause), p.name) for cause in self.effects for p in cause.parameters(0))
        return [
            *(("geometry", None, np.nan, _name(row)) for row in self.parameters.itertuples()),
            *(("effect", name, None, parameter) for name, parameter in sizes),
        ]

    @property
    def scales(self) -> NDArray:
        """SI values (n,) of the units of the tables."""
        return np.array(
            [_SI[unit] for unit in self.parameters["unit"]] + [p.si for c in self.effects for p in c.parameters(0)]
        )


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
    """Return the changes of zeros, links and common effects, by the full covariances of both models.

    ``parameters``: chain_parameters.parquet of each run. Tolerances count once; without tolerances, the numbers that
    describe all errors of the links are compared. A ``joint-offset`` counts with the zero of its joint. Effects that
    one model lacks widen the differences by the bias that their absence may cause.
    """
    if why := _stated_otherwise(before, now, parameters, parameters_now):
        return not_assessed(why)
    numbers = _compared_numbers(before, now, parameters)
    old, new = (_estimate(one, numbers) for one in (before, now))
    sized = np.zeros(len(old.values))
    sized[: len(numbers.parameters)] = _has_offset((before, now), numbers.parameters)
    sized[len(numbers.parameters) :] = 1.0
    variances = np.diag(old.covariance) + np.diag(new.covariance)
    prior = np.diag(_WIDE**2 * sized * (old.values**2 + new.values**2 + variances))
    prior[: len(numbers.prior), : len(numbers.prior)] += numbers.prior
    widened = _bias(before, now, numbers) + _bias(now, before, numbers)
    compared = compare(old.values, old.covariance, new.values, new.covariance, np.linalg.inv(prior), widened)
    if not len(compared.observable):
        return not_assessed("neither campaign determines the machine better than its tolerances")
    informed = np.diag(new.covariance) < (1.0 - LEAST_REDUCTION) * np.diag(prior)
    changed, scale, names = compared.changed(LEVEL), numbers.scales, numbers.names
    rows = pd.DataFrame(names, columns=NAMES).assign(sigma_difference=compared.sigma / scale)
    z = compared.difference / np.where(compared.sigma > 0.0, compared.sigma, np.inf)
    rows["z"] = np.where(informed & (compared.sigma > 0.0), z, np.nan)
    rows["reason"] = [None if known else "not identifiable" for known in informed]
    rows["changed"], rows["change"], rows["sigma_change"], rows["instead"] = changed is None, np.nan, np.nan, None
    apart = _not_compared(before, now, parameters, numbers)
    if changed is None:
        rows = rows.assign(changed=beyond_chance(rows["z"].to_numpy(float)))
        return RunStep(_joined(rows, apart), rebuilt=True)
    sizes = zip(changed, *compared.sizes(changed), compared.alternatives_to(changed), strict=True)
    for at, size, sigma, rivals in sizes:
        rival_names = ", ".join(_in_words(names[rival]) for rival in rivals) or None
        rows.loc[at, ["changed", "change", "sigma_change", "instead"]] = (
            True,
            size / scale[at],
            sigma / scale[at],
            rival_names,
        )
    return RunStep(_joined(rows, apart))


def _in_words(name: tuple[object, ...]) -> str:
    return f"{name[3]} of {name[1]}" if name[0] == "effect" else str(name[3])


def _joined(rows: pd.DataFrame, apart: pd.DataFrame) -> pd.DataFrame:
    return pd.concat([rows, apart], ignore_index=True) if len(apart) else rows


def _stated_otherwise(
    before: ExtendedChain, now: ExtendedChain, parameters: pd.DataFrame, parameters_now: pd.DataFrame
) -> str:
    """Return in words why the numbers of two models are not the same ones; empty where they are."""
    nodes = [one.tree.nodes for one in (before, now)]
    if [n.link for n in nodes[0]] != [n.link for n in nodes[1]] or any(
        np.abs(a.t - b.t).max() > _SAME or np.abs(a.R - b.R).max() > _SAME for a, b in zip(*nodes, strict=True)
    ):
        return "their campaign.toml name another nominal geometry"
    tables = [table.reset_index(drop=True) for table in (parameters, parameters_now)]
    if not tables[0]["tolerance"].equals(tables[1]["tolerance"]) and len(tables[0]) == len(tables[1]):
        return "their campaign.toml name other tolerances"
    if not tables[0][["joint", "parameter"]].equals(tables[1][["joint", "parameter"]]):
        return "they leave other numbers of the links free: other tolerances, or the base is surveyed in one of them"
    if isinstance(before.tree, ClosedTree) and not _is_toleranced(parameters):
        return "without [mechanism.tolerance] length_mm and angle_deg, the numbers of links in loops are a choice"
    return ""


def _is_toleranced(parameters: pd.DataFrame) -> bool:
    """Return True if all numbers of a chain's links have a tolerance."""
    tolerance = parameters["tolerance"].to_numpy(float)
    return bool((tolerance > 0.0).all() and np.isfinite(tolerance).all())


def _compared_numbers(before: ExtendedChain, now: ExtendedChain, parameters: pd.DataFrame) -> _Numbers:
    """Return the compared rows and effects; without tolerances the rows that alone describe every error."""
    own_si = np.array([_SI[unit] for unit in parameters["unit"]])
    tolerance = own_si * parameters["tolerance"].to_numpy(float)
    if _is_toleranced(parameters):
        return _Numbers(parameters, np.diag(tolerance**2), _common_effects(before, now, parameters))
    is_offset = (parameters["parameter"] == "offset").to_numpy()
    places, prior = [*np.flatnonzero(is_offset)], [np.diag(tolerance[is_offset] ** 2)]
    for joint, components, block in _free_links(before):
        rows = {str(r.parameter): k for k, r in enumerate(parameters.itertuples()) if r.joint == joint}
        places += [rows[_COMPONENTS[c]] for c in components]
        prior.append(block)
    order = np.argsort(places)
    spread = _block_diagonal(prior)[np.ix_(order, order)]
    chosen = parameters.iloc[np.array(places, int)[order]]
    return _Numbers(chosen, spread, _common_effects(before, now, parameters))


def _free_links(extended: ExtendedChain) -> Iterator[tuple[str, list[int], NDArray]]:
    """Yield each joint with errors of its frame, the components that alone describe them, and these components' wide
    prior covariance, SI.

    Errors that another number of the chain stands for have no variance.
    """
    wide = np.array([FREE_LENGTH_M] * 3 + [FREE_ANGLE_RAD] * 3)
    for place, k in enumerate(extended.moved):
        node, part = extended.tree.nodes[k], slice(TWIST * place, TWIST * (place + 1))
        own_zero = axis_twist(node) / wide
        apart = np.eye(TWIST) - np.outer(own_zero, own_zero) / max(float(own_zero @ own_zero), 1e-300)
        variance, directions = np.linalg.eigh(apart @ (extended.covariance[part, part] / np.outer(wide, wide)) @ apart)
        own = wide[:, None] * directions[:, variance > _NO_VARIANCE]
        if own.shape[1]:
            _, _, components = along_components(own)
            yield node.joint or node.link, components, own[components] @ own[components].T


def _block_diagonal(blocks: list[NDArray]) -> NDArray:
    size = sum(len(block) for block in blocks)
    whole, at = np.zeros((size, size)), 0
    for block in blocks:
        whole[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return whole


def _persistent(extended: ExtendedChain, parameters: pd.DataFrame) -> list[ChainCause]:
    """Return the causes that stay with the machine, without offsets that count with the zero of their joint."""
    return [c for c in extended.causes if c.is_persistent and not _counts_with_zero(c, parameters)]


def _counts_with_zero(cause: ChainCause, parameters: pd.DataFrame) -> bool:
    zeros = set(parameters.loc[parameters["parameter"] == "offset", "joint"])
    return isinstance(cause, JointOffset) and cause.joint in zeros


def _common_effects(before: ExtendedChain, now: ExtendedChain, parameters: pd.DataFrame) -> tuple[ChainCause, ...]:
    """Return the causes of the earlier model that the later one holds in the same form, each name once."""
    kept = [_persistent(one, parameters) for one in (before, now)]
    names = [Counter(owner(cause) for cause in causes) for causes in kept]
    forms = {_form_key(cause) for cause in kept[1]}
    return tuple(
        cause
        for cause in kept[0]
        if cause.catalogued and all(count[owner(cause)] == 1 for count in names) and _form_key(cause) in forms
        if _is_sized(before, cause)
    )


def _is_sized(extended: ExtendedChain, cause: ChainCause) -> bool:
    """Return True if the reported numbers of an effect are its parameters, which the covariance holds."""
    (values,) = (effect.values for effect in extended.effects if effect.cause == cause)
    reported = {number.name for number in cause.reported(values, extended.covariance_of(cause), 0)}
    return {p.name for p in cause.parameters(0)} <= reported


def _form_key(cause: ChainCause) -> tuple[object, ...]:
    """Return a key that causes share if their parameters mean the same."""
    settings = sorted((name, repr(value)) for name, value in cause.settings().items() if name not in _OF_THE_FIT)
    return cause.id, *settings


def _effect_key(cause: ChainCause) -> tuple[object, ...]:
    """Return a key that causes share if they are one effect, in any form."""
    return cause.id, cause.subject, getattr(cause, "columns", ())


def _not_compared(
    before: ExtendedChain, now: ExtendedChain, parameters: pd.DataFrame, numbers: _Numbers
) -> pd.DataFrame:
    """Return rows with the reason for numbers of the later model that are not compared, and stand in both models."""
    left = parameters.loc[~parameters.index.isin(numbers.parameters.index)]
    rows: list[tuple[object, ...]] = [("geometry", None, np.nan, _name(r), _DEPENDENT) for r in left.itertuples()]
    compared, old = {owner(cause) for cause in numbers.effects}, {owner(cause) for cause in before.causes}
    for effect in now.effects:
        cause = effect.cause
        if cause.is_persistent and owner(cause) in old - compared:
            why = _WITH_ZERO if _counts_with_zero(cause, parameters) else _ANOTHER_FORM
            reported = cause.reported(effect.values, now.covariance_of(cause), 0)
            rows += [("effect", owner(cause), None, p.name, why) for p in reported if not isinstance(p.value, str)]
    return pd.DataFrame(rows, columns=[*NAMES, "reason"]).assign(changed=False)


def _estimate(extended: ExtendedChain, numbers: _Numbers) -> _Estimate:
    slopes = _slopes(extended, numbers)
    return _Estimate(slopes @ _unknowns(extended), slopes @ extended.covariance @ slopes.T)


def _unknowns(extended: ExtendedChain) -> NDArray:
    """Return twists of the moved nodes, then the effects' whole values, in the order of the covariance."""
    causes_with_known_part = [effect.cause.with_known_part(effect.values) for effect in extended.effects]
    return np.concatenate([extended.twists[extended.moved].ravel(), *causes_with_known_part])


def _slopes(extended: ExtendedChain, numbers: _Numbers) -> NDArray:
    """Return the derivatives (n, G) of the numbers by the unknowns; an offset lies along the joint's own axis."""
    slopes = np.zeros((len(numbers.names), len(extended.covariance)))
    place_of = {int(node): place for place, node in enumerate(extended.moved)}
    offsets = {
        e.cause.joint: extended.layout[e.cause.key] for e in extended.effects if isinstance(e.cause, JointOffset)
    }
    node_of = {node.joint or node.link: k for k, node in enumerate(extended.tree.nodes)}
    for row, number in enumerate(numbers.parameters.itertuples()):
        k = node_of[str(number.joint)]
        if k in place_of:
            slopes[row, TWIST * place_of[k] : TWIST * (place_of[k] + 1)] = _direction(
                extended, k, str(number.parameter)
            )
        if number.parameter == "offset" and number.joint in offsets:
            slopes[row, offsets[str(number.joint)]] = 1.0
    own, row = {_form_key(cause): cause for cause in extended.causes}, len(numbers.parameters)
    for cause in numbers.effects:
        part = extended.layout[own[_form_key(cause)].key]
        count = part.stop - part.start
        slopes[row : row + count, part] = np.eye(count)
        row += count
    return slopes


def _direction(extended: ExtendedChain, k: int, parameter: str) -> NDArray:
    """Return the derivative (6,) of a number by the twist of a joint's frame; the zero is no number of the link."""
    node = extended.tree.nodes[k]
    zero = axis_twist(node)
    if parameter == "offset" and node.kind != JointKind.FIXED:
        return np.asarray(zero)
    component = np.eye(TWIST)[_COMPONENTS.index(parameter)]
    return np.asarray(component - (zero @ component) * zero)


def _has_offset(models: tuple[ExtendedChain, ...], parameters: pd.DataFrame) -> NDArray:
    joints = {cause.joint for model in models for cause in model.causes if isinstance(cause, JointOffset)}
    return ((parameters["parameter"] == "offset") & parameters["joint"].isin(joints)).to_numpy()


def _bias(extended: ExtendedChain, other_model: ExtendedChain, numbers: _Numbers) -> NDArray:
    """Return the shifts of the numbers as a covariance (n, n), if effects that the other model lacks were left out."""
    others = {_effect_key(cause) for cause in other_model.causes}
    alone = [cause for cause in _persistent(extended, numbers.parameters) if _effect_key(cause) not in others]
    slopes = _slopes(extended, numbers)
    linear = np.concatenate([slopes, np.eye(len(extended.covariance))])
    at, count = [np.r_[extended.layout[cause.key]] for cause in alone], len(slopes)
    return shift_without_effects(
        linear @ _unknowns(extended),
        linear @ extended.covariance @ linear.T,
        np.arange(count),
        [count + indices for indices in at],
    )
