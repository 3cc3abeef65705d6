"""Each body as the quality checks see it: its points over time, a first robust fit, and what that leaves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from truing.belonging.counted_times import merely_counts
from truing.quality.bodies import BodyView, Surroundings, body_view, first_shape
from truing.schemas.columns import COLUMNS
from truing.stages.common.point_arrays import number_column, pose_ids, pose_points, survey_points

if TYPE_CHECKING:
    import pyarrow as pa


def surroundings(observations: pa.Table, configurations: pa.Table | None, drives: tuple[str, ...]) -> Surroundings:
    """The poses that were observed, ordered by time where the campaign tells it, else as they came."""
    observed, shared = pose_ids(observations), "point" in observations.column_names
    if configurations is None:
        none = np.zeros((len(observed), 0))
        return Surroundings(observed, np.arange(float(len(observed))), none, (), None, shared=shared, is_counted=True)
    time = number_column(configurations, "time_s")
    order = np.argsort(time, kind="stable")
    ids = configurations.column("pose").to_pylist()
    seen = set(observed)
    rows = np.array([i for i in order if ids[i] in seen], dtype=np.int64)
    names = [n for n in configurations.schema.names if COLUMNS["rho"].matches(n) or n in drives]
    values = {n: number_column(configurations, n)[rows] for n in names}
    varying = tuple(n for n in names if np.nanstd(values[n]) > 0.0)
    has_temperature = "temperature_c" in configurations.schema.names
    return Surroundings(
        tuple(ids[i] for i in rows),
        time[rows],
        np.column_stack([values[n] for n in varying]) if varying else np.zeros((len(rows), 0)),
        varying,
        number_column(configurations, "temperature_c")[rows] if has_temperature else None,
        tuple(pose for pose in ids if pose not in seen),
        shared,
        merely_counts(time[order], np.arange(len(order)), np.zeros(len(order), dtype=np.int64)),
    )


def body_views(tables: Mapping[str, pa.Table], around: Surroundings) -> list[BodyView]:
    """Every body of the observations, fitted robustly pose by pose."""
    observations, survey = tables["observations"], tables.get("survey")
    bodies = dict.fromkeys(observations.column("body").to_pylist())
    return [_view(observations, survey, body, around) for body in bodies]


def _view(observations: pa.Table, survey: pa.Table | None, body: str, around: Surroundings) -> BodyView:
    place = survey_points(survey, body) if survey is not None else None
    is_surveyed = place is not None and bool(place.targets)
    if place is None or not is_surveyed:
        place = first_shape(pose_points(observations, body, around.poses))
    points = pose_points(observations, body, around.poses, place.targets)
    return body_view(body, place, points, around, is_surveyed=is_surveyed)
