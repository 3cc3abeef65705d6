"""The checks of a campaign's quality: each gives a value, a limit, a verdict and one sentence.

A failing check gates the exit code, so together they may trip on one good campaign in a hundred at most: that budget
(``[qa] false_alarm``) is shared out among the checks that rest on chance, and within a check among its
subjects. Checks that only warn are held at ten times their share.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.quality.bodies import BodyView, Surroundings
from truing.stages.common.point_arrays import number_column
from truing.stages.common.repeats import repeated_poses
from truing.stages.quality.check import Check
from truing.stages.quality.limits import CampaignLimits
from truing.stages.quality.of_names import due
from truing.stages.quality.of_noise import noise, noise_by_pose
from truing.stages.quality.of_repeats import repeatability
from truing.stages.quality.of_targets import (
    attachment_labels,
    completeness,
    exchanged_labels,
    geometry,
    gross_errors,
    moved_targets,
    unobserved_poses,
)
from truing.stages.quality.of_time import base_drift, temperature_span, time_gaps, time_unit
from truing.stages.quality.temperature_units import temperature_columns, temperature_units

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

_CHANCE_CHECKS = 3  # noise per body, noise per pose, repeatability: the failing checks that chance can trip


def all_checks(
    bodies: Sequence[BodyView],
    reference: BodyView | None,
    around: Surroundings,
    attachments: NDArray[np.float64],
    settings: Campaign,
    limits: CampaignLimits,
    tables: Mapping[str, pa.Table],
) -> Iterator[Check]:
    """Every check: of the campaign's tables, body by body, then over time; attachments (L, 3) nominal, in m."""
    resurveys, table = tables.get("resurveys"), tables.get("configurations")
    share = settings.qa.false_alarm / _CHANCE_CHECKS
    yield unobserved_poses(around, limits)
    yield from attachment_labels(bodies, attachments)
    for body in bodies:
        yield from completeness(body, due(resurveys, body, around), limits)
        yield from geometry(body, limits)
        yield from gross_errors(body, limits)
        yield from exchanged_labels(body, around)
        yield from moved_targets(body, around, 10.0 * share / len(bodies))
        yield from noise(body, around, share / len(bodies))
        yield from noise_by_pose(body, around, share / len(bodies))
    yield from base_drift(reference, 10.0 * share, frame_stays=settings.is_frame_fixed)
    stood = settings.is_frame_fixed and reference is None
    yield from repeatability(bodies, around, *_repeats(table, around, settings), share, instrument_stood=stood)
    yield time_gaps(around, limits)
    time = around.time if table is None else number_column(table, "time_s")
    yield time_unit(time, None, "configurations", "pose", is_counted=around.is_counted)
    yield temperature_span(around, limits)
    yield from _temperature_units(table, settings.mechanism.reference_temperature_c)


def _temperature_units(configurations: pa.Table | None, reference_c: float) -> Iterator[Check]:
    if configurations is None:
        yield from temperature_units({}, reference_c)
        return
    recorded = {name: number_column(configurations, name) for name in temperature_columns(configurations.column_names)}
    order = np.argsort(number_column(configurations, "time_s"), kind="stable")
    rows = [f"pose {pose}" for pose in configurations.column("pose").to_pylist()]
    yield from temperature_units(recorded, reference_c, rows, order)


def _repeats(
    configurations: pa.Table | None, around: Surroundings, settings: Campaign
) -> tuple[list[NDArray[np.int64]], str]:
    """Poses that repeat one another, as numbers of those that were seen, and how that is known."""
    if configurations is None:
        return [], ""
    groups, how = repeated_poses(configurations, settings.campaign.drives, settings.noise.actuator_mm)
    poses = configurations.column("pose").to_pylist()
    place = {pose: at for at, pose in enumerate(around.poses)}
    seen = ([place[poses[row]] for row in group if poses[row] in place] for group in groups)
    return [np.array(group) for group in seen if len(group) > 1], how
