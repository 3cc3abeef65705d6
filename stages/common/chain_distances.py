"""Distances between ends of a chain: their table as channels, and the fit of the nominal chain to them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Mask
from truing.simulation.mechanisms.chains.conditions import ChainConditions, MeasuredChannels
from truing.simulation.mechanisms.chains.joint_table import STATION
from truing.simulation.mechanisms.chains.measured_lines import GROUND, fitted_places, lines_at
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.common.chain_measurements import MeasuredLinks, survey_of
from truing.stages.common.chain_start import NominalFit
from truing.stages.common.point_arrays import number_column, positions

_MM = 1e-3


def measured_distances(tables: Mapping[str, pa.Table], tree: Tree, poses: tuple[int | str, ...]) -> MeasuredLinks:
    """Return every end of a distance as a channel, a station on the ground; values (B, D, 1) are the distances."""
    table, survey = tables["distances"], tables.get("survey")
    links, names = ([table.column(f"{end}_{what}").to_pylist() for end in ("from", "to")] for what in ("link", "end"))
    pairs = [
        [(link or GROUND, name) for link, name in zip(*link_pair, strict=True)]
        for link_pair in zip(links, names, strict=True)
    ]
    ends = list(dict.fromkeys([*pairs[0], *pairs[1]]))
    if unknown := [link for link, _ in ends if link not in tree.links]:
        raise ValueError(f"link {unknown[0]} is no link of the chain; there are {', '.join(tree.links)}")
    both = np.array([[ends.index(a), ends.index(b)] for a, b in zip(*pairs, strict=True)])
    lines, number = np.unique(both, axis=0, return_inverse=True)
    at = positions(table.column("pose"), poses)
    known = at >= 0
    values, cov = np.zeros((len(poses), len(lines), 1)), np.zeros((len(poses), len(lines), 1, 1))
    is_observed = np.zeros((len(poses), len(lines)), bool)
    index = at[known], number.ravel()[known]
    values[index] = number_column(table, "reading_mm")[known, None] * _MM
    cov[index] = (number_column(table, "sigma_mm")[known, None, None] * _MM) ** 2
    is_observed[index] = True
    surveys = {link: {} if survey is None else survey_of(survey, link) for link, _ in ends}
    nowhere = np.full(3, np.nan), np.full((3, 3), np.nan)
    surveyed = [surveys[link].get(name, nowhere) for link, name in ends]
    channels = MeasuredChannels(
        tuple(name for _, name in ends),
        tuple(link for link, _ in ends),
        np.array([tree.links[link] for link, _ in ends]),
        np.zeros(len(ends), bool),
    )
    reference = np.tile(np.eye(3), (len(poses), len(ends), 1, 1))
    points, covs = (np.stack(part) for part in zip(*surveyed, strict=True))
    return MeasuredLinks(channels, values, cov, is_observed, points, covs, reference, lines)


def is_station(measured: MeasuredLinks) -> Mask:
    """Mask (K,) of the channels that are stations."""
    return np.array([name.startswith(STATION) for name in measured.channels.names], bool)


def fit_of_distances(tree: Tree, measured: MeasuredLinks, conditions: ChainConditions, fitted: Mask) -> NominalFit:
    """Return the fit of the nominal chain to distances (B, D, 1), with the base as frame.

    Only stations and targets without a survey have free places. The spread includes the movement of one end as seen
    from the other: the length of a bar shows none.
    """
    count, ends, node = len(measured.values), measured.ends, measured.channels.node
    assert ends is not None
    free = np.flatnonzero(~np.isfinite(measured.surveyed).all(1))
    tools = np.tile(np.eye(3), (len(node), 1, 1))

    def start_of(chosen: Mask, given: ChainConditions, other: Array | None = None) -> StartValues:
        used, observations = fitted & chosen, measured.values if other is None else other
        lines = lines_at(tree, node, ends, given.subset(used), observations[used, :, 0], measured.is_observed[used])
        shape = fitted_places(lines, np.nan_to_num(measured.surveyed), free, is_station(measured))
        errors = lines.errors(shape)[..., None]
        rms = float(np.sqrt(np.nanmean(errors**2)))
        return StartValues(np.eye(3)[None], np.zeros((1, 3)), shape, tools, rms, lines.spread(shape), errors)

    def errors_at(start: StartValues, given: ChainConditions, observations: Array) -> Array:
        lines = lines_at(tree, node, ends, given, observations[..., 0], measured.is_observed)
        return lines.errors(start.shape)[..., None]

    R, t = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    return NominalFit(R, t, None, False, start_of, errors_at, measured.values, measured.is_position)
