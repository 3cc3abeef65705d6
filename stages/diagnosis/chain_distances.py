"""Distances next to points or poses of a chain: all as numbers on the same channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truing.simulation.mechanisms.chains.conditions import MeasuredChannels
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.stages.common.chain_measurements import MeasuredLinks

_AXES = 3


def with_distances(points: MeasuredLinks | None, lines: MeasuredLinks | None) -> MeasuredLinks:
    """Points or poses, distances, or both: then their coordinates and the distances are numbers (B, M + D, 1).

    Coordinates of one point count as independent next to distances. A target of both is one channel.
    """
    if points is None or lines is None:
        part = points or lines
        assert part is not None
        return part
    assert lines.ends is not None
    keys, others = (
        list(zip(dataset.channels.links, dataset.channels.names, strict=True)) for dataset in (points, lines)
    )
    extra = np.array([k for k, key in enumerate(others) if key not in keys], int)
    keys += [others[k] for k in extra]
    count, poses = len(points.channels.names), len(points.values)
    coupling = points.coupling
    if coupling is not None:
        coupling = np.concatenate([coupling, np.zeros((poses, len(extra), 3, 3))], 1)
    variances = np.diagonal(points.cov, axis1=-2, axis2=-1).reshape(poses, -1)
    return MeasuredLinks(
        MeasuredChannels(
            tuple(name for _, name in keys),
            tuple(link for link, _ in keys),
            np.concatenate([points.channels.node, lines.channels.node[extra]]),
            np.concatenate([points.channels.is_rotation, lines.channels.is_rotation[extra]]),
        ),
        np.concatenate([points.values.reshape(poses, -1, 1), lines.values], 1),
        np.concatenate([variances[..., None, None], lines.cov], 1),
        np.concatenate([np.repeat(points.is_observed, _AXES, axis=1), lines.is_observed], 1),
        np.concatenate([points.surveyed, lines.surveyed[extra]]),
        np.concatenate([points.survey_cov, lines.survey_cov[extra]]),
        np.concatenate([points.reference, lines.reference[:, extra]], 1),
        ends=np.array([keys.index(key) for key in others])[lines.ends],
        coordinates=np.indices((count, _AXES)).reshape(2, -1).T,
        coupling=coupling,
    )


def with_places(start: StartValues, measured: MeasuredLinks) -> StartValues:
    """Start values of points, with survey or zero for the channels that only distances reach."""
    count = len(start.shape)
    rest = np.nan_to_num(measured.surveyed[count:])
    tools = np.tile(np.eye(3), (len(rest), 1, 1))
    return replace(start, shape=np.concatenate([start.shape, rest]), tool=np.concatenate([start.tool, tools]))
