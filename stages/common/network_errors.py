"""What the numbers measured in a pose have in common where its points come out of photographs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.measured_numbers import NetworkErrors, pose_numbers, shift_number
from truing.stages.common.point_arrays import number_column, positions
from truing.stages.common.point_errors import common_correlation

if TYPE_CHECKING:
    import pyarrow as pa

_EFFECTS = (*(f"effect_{a}_mm" for a in "xyz"), *(f"effect_r{a}_rad" for a in "xyz"))
_TO_SI = np.array([1e-3] * 3 + [1.0] * 3)
_NOTHING = 1e-9  # share of a variance
_TABLES = ("pose_sensitivities", "pose_covariances", "shift_covariances", "shift_sensitivities")


def network_errors(
    tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], bodies: Mapping[str, NDArray], legs: int
) -> NetworkErrors | None:
    """Return what the network of rays left of the poses of bodies, each with its covariances (B, 6, 6), and of the
    shifts of the attachments; None where points are independent."""
    if not any(name in tables and tables[name].num_rows for name in _TABLES):
        return None
    numbers = [str(name) for body in bodies for name in pose_numbers(body)]
    numbers += [shift_number(leg + 1) for leg in range(legs)]
    covariance = np.full((len(poses), len(numbers), len(numbers)), np.nan)
    for n, own in enumerate(bodies.values()):
        covariance[:, 6 * n : 6 * n + 6, 6 * n : 6 * n + 6] = own
    for name in ("pose_covariances", "shift_covariances"):
        _fill(covariance, tables.get(name), poses, tuple(numbers))
    of_survey = _of_survey(tables.get("survey_covariances"), tuple(numbers))
    shifted = np.arange(len(numbers)) >= 6 * len(bodies)  # whose covariances are told without the survey
    covariance += np.where(shifted[:, None] | shifted, of_survey, 0.0)
    parameters, effects = _effects(tables, poses, list(bodies), legs)
    root = _root(common_correlation(tables.get("camera_correlations"), parameters))
    in_all = np.repeat(_root(of_survey)[None], len(poses), 0)
    return NetworkErrors(tuple(numbers), covariance, np.concatenate([effects @ root, in_all], -1))


def _of_survey(table: pa.Table | None, numbers: tuple[str, ...]) -> NDArray:
    """Return the covariance (Q, Q) that the survey brings to all poses alike."""
    found = np.zeros((len(numbers), len(numbers)))
    if table is not None and table.num_rows:
        one, other = (positions(table.column(f"{name}_number"), numbers) for name in ("measured", "other"))
        kept = (one >= 0) & (other >= 0)
        value = number_column(table, "joint_covariance")[kept]
        found[one[kept], other[kept]] = found[other[kept], one[kept]] = value
    return found


def _fill(covariance: NDArray, table: pa.Table | None, poses: tuple[int | str, ...], numbers: tuple[str, ...]) -> None:
    if table is None or not table.num_rows:
        return
    places = (table.column("pose"), poses), *((table.column(f"{o}_number"), numbers) for o in ("measured", "other"))
    pose, one, other = (positions(*place) for place in places)
    kept = (pose >= 0) & (one >= 0) & (other >= 0)
    value = number_column(table, "joint_covariance")[kept]
    covariance[pose[kept], one[kept], other[kept]] = covariance[pose[kept], other[kept], one[kept]] = value


def _effects(
    tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], bodies: list[str], legs: int
) -> tuple[tuple[str, ...], NDArray]:
    """Return the parameters common to all poses, and what one standard deviation of each does (B, Q, K), SI."""
    given = [tables.get(name) for name in ("pose_sensitivities", "shift_sensitivities")]
    found = [table for table in given if table is not None]
    parameters = tuple(dict.fromkeys(name for table in found for name in table.column("parameter").to_pylist()))
    effects = np.zeros((len(poses), 6 * len(bodies) + legs, len(parameters)))
    for table, columns, si in ((given[0], _EFFECTS, _TO_SI), (given[1], ("effect_um",), np.array([1e-6]))):
        if table is None or not table.num_rows:
            continue
        pose, parameter = positions(table.column("pose"), poses), positions(table.column("parameter"), parameters)
        if len(columns) > 1:
            first = 6 * positions(table.column("body"), tuple(bodies))
        else:
            first = 6 * len(bodies) + number_column(table, "leg").astype(int) - 1
        kept = (pose >= 0) & (first >= 0)
        values = np.column_stack([number_column(table, name) for name in columns]) * si
        for n in range(len(columns)):
            effects[pose[kept], first[kept] + n, parameter[kept]] = values[kept, n]
    return parameters, effects


def _root(covariance: NDArray) -> NDArray:
    """Return G (K, k) with G G' the covariance, of columns that say anything."""
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    told = values > _NOTHING
    return np.asarray(scale[:, None] * vectors[:, told] * np.sqrt(values[told]))
