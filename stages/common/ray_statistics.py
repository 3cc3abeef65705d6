"""Tables on shared parameters from the rays of each pose: writing and reading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.photograph_artifacts import subject_and_name
from truing.simulation.photographs.ray_poses import RayParameter
from truing.stages.common.point_arrays import number_column, positions

if TYPE_CHECKING:
    from truing.estimation.bundle.network import Network, NetworkState
    from truing.estimation.bundle.normal_equations import Observed
    from truing.estimation.bundle.ray_statistics import RayStatistics, SharedNumber

_MM = 1e3


def ray_tables(
    observed: Observed, state: NetworkState, poses: Sequence[int | str], points: Sequence[str], bars: Sequence[str]
) -> dict[str, pa.Table]:
    """Artifacts ray_statistics, ray_information and ray_effects of an adjusted network.

    Arguments: names of its poses, points (by number) and scale bars; points without a name are omitted.
    """
    from truing.estimation.bundle.ray_statistics import ray_statistics

    statistics = ray_statistics(observed, state)
    names = np.array([_parameter_name(number, observed.network, bars) for number in statistics.numbers], object)
    informative = np.flatnonzero(np.any(statistics.information != 0.0, (1, 2)))
    return {
        "ray_statistics": _statistics(statistics, names, poses, informative),
        "ray_information": _information(statistics, names, poses, informative),
        "ray_effects": _effects(statistics, names, poses, points, observed.network.point_pose),
    }


def _parameter_name(number: SharedNumber, network: Network, bars: Sequence[str]) -> str:
    owners = {"camera": [camera.name for camera in network.cameras], "bar": list(bars)}
    owners["window"] = owners["camera"]
    owner = owners[number.kind][number.owner] if number.kind in owners else ""
    return " ".join(filter(None, (number.kind, owner, number.name)))


def _statistics(statistics: RayStatistics, names: Array, poses: Sequence[int | str], informative: NDArray) -> pa.Table:
    count, scale = len(names), np.array([number.scale for number in statistics.numbers])
    columns = {
        "pose": _repeated(poses, informative, count),
        "shared_number": np.tile(names, len(informative)).tolist(),
        "shared_unit": [number.unit for number in statistics.numbers] * len(informative),
        "shared_scale": np.tile(scale, len(informative)),
        "shared_sigma": [number.sigma for number in statistics.numbers] * len(informative),
        "shared_mean": [number.mean for number in statistics.numbers] * len(informative),
        "score": (statistics.score[informative] * scale).ravel(),
    }
    return _table("ray_statistics", columns, poses)


def _information(statistics: RayStatistics, names: Array, poses: Sequence[int | str], informative: NDArray) -> pa.Table:
    first, second = np.triu_indices(len(names))
    scale = np.array([number.scale for number in statistics.numbers])
    values = statistics.information[informative][:, first, second] * (scale[first] * scale[second])
    columns = {
        "pose": _repeated(poses, informative, len(first)),
        "shared_number": np.tile(names[first], len(informative)).tolist(),
        "other_number": np.tile(names[second], len(informative)).tolist(),
        "information": values.ravel(),
    }
    return _table("ray_information", columns, poses)


def _effects(
    statistics: RayStatistics, names: Array, poses: Sequence[int | str], points: Sequence[str], pose: NDArray
) -> pa.Table:
    indices = np.flatnonzero(np.isfinite(statistics.by_point).all((1, 2)) & np.array([bool(name) for name in points]))
    scale = np.array([number.scale for number in statistics.numbers])
    moves = np.swapaxes(statistics.by_point[indices] * scale, 1, 2).reshape(-1, 3) * _MM
    columns: dict[str, object] = {
        "pose": _repeated(poses, pose[indices], len(names)),
        "point": np.repeat(np.array(points, object)[indices], len(names)).tolist(),
        "shared_number": np.tile(names, len(indices)).tolist(),
    }
    columns |= {f"moves_{axis}_mm": moves[:, k] for k, axis in enumerate("xyz")}
    return _table("ray_effects", columns, poses)


def _repeated(poses: Sequence[int | str], chosen: NDArray, times: int) -> list[object]:
    return np.repeat(np.array(poses, object)[chosen], times).tolist()


def _table(artifact: str, columns: Mapping[str, object], poses: Sequence[int | str]) -> pa.Table:
    identifier = "int64" if all(isinstance(pose, int) for pose in poses) else "string"
    return pa.Table.from_pydict(dict(columns), schema=ARTIFACTS[artifact].arrow_schema(identifier))


def shared_numbers(table: pa.Table) -> tuple[RayParameter, ...]:
    """Shared parameters of ray_statistics, each once, in their order."""
    ray_parameters: dict[str, RayParameter] = {}
    suffixes = ("unit", "scale", "sigma", "mean")
    for row in table.select(
        ["shared_number", "shared_unit", "shared_scale", "shared_sigma", "shared_mean"]
    ).to_pylist():
        name = row["shared_number"]
        if name not in ray_parameters:
            ray_parameters[name] = RayParameter(
                *subject_and_name(name), *(row[f"shared_{suffix}"] for suffix in suffixes)
            )
    return tuple(ray_parameters.values())


def information_and_score(
    tables: Mapping[str, pa.Table], poses: Sequence[int | str], numbers: Sequence[RayParameter]
) -> tuple[Array, Array]:
    """Information (B, T, T) and score (B, T), per scale of each parameter; zero for poses without rays."""
    at = {number.called: index for index, number in enumerate(numbers)}
    information, score = np.zeros((len(poses), len(at), len(at))), np.zeros((len(poses), len(at)))
    table = tables["ray_statistics"]
    row, index = positions(table.column("pose"), tuple(poses)), _indices(table, "shared_number", at)
    score[row[row >= 0], index[row >= 0]] = number_column(table, "score")[row >= 0]
    table = tables["ray_information"]
    row = positions(table.column("pose"), tuple(poses))
    first, second = _indices(table, "shared_number", at), _indices(table, "other_number", at)
    values, known = number_column(table, "information"), row >= 0
    information[row[known], first[known], second[known]] = values[known]
    information[row[known], second[known], first[known]] = values[known]
    return information, score


def effects_on_points(table: pa.Table, numbers: Sequence[RayParameter]) -> tuple[list[tuple[object, str]], Array]:
    """Pose and name (N) of the points of ray_effects, and their shifts (N, 3, T), m per scale of each parameter."""
    at = {number.called: index for index, number in enumerate(numbers)}
    keys = list(zip(table.column("pose").to_pylist(), table.column("point").to_pylist(), strict=True))
    rows = {key: n for n, key in enumerate(dict.fromkeys(keys))}
    displacements = np.zeros((len(rows), 3, len(at)))
    row, index = np.array([rows[key] for key in keys], int), _indices(table, "shared_number", at)
    for k, axis in enumerate("xyz"):
        displacements[row, k, index] = number_column(table, f"moves_{axis}_mm") / _MM
    return list(rows), displacements


def _indices(table: pa.Table, column: str, at: Mapping[str, int]) -> NDArray:
    return np.array([at[name] for name in table.column(column).to_pylist()], int)
