"""Stage pose: pose of each body in each pose of the campaign by every estimator, with residuals of its targets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.schemas.artifacts import ARTIFACTS
from truing.stages.common.missing_data import NO_BODIES
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

DECLARATION = Stage(
    name="pose",
    reads=(
        *("observations?", "survey?", "scans?", "measured_poses?", "readings?", "given_compliance?"),
        *("object_points?", "point_correlations?", "point_sensitivities?", "camera_correlations?"),
        "qa?",
    ),
    leaves=(
        *("poses?", "residuals?", "pose_sensitivities?", "pose_covariances?"),
        *("displacement?", "reading_residuals?", "run_terms?", "exclusion_effects?"),
    ),
    settings=(
        *("campaign.kind", "bodies", "measurement.frame", "mechanism.type", "exclude", "keep", "interferometer.beams"),
        *(
            "mechanism.legs",
            "mechanism.height_mm",
            "mechanism.elements",
            "mechanism.platform",
            "mechanism.base",
            "mechanism.tolerance",
        ),
    ),
    summary="rigid-body poses or displacements under load, with covariance, and the residuals of every reading",
    streams=("observations",),
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Fit every body in every pose, relative to its survey where there is one, and see it from the reference body.

    Points that came out of a network of rays are fitted with what their errors have in common, all bodies of a pose
    together. Of a loaded platform: join its readings to displacements.
    """
    if settings.campaign.kind == "interferometer":
        from truing.stages.sensor.platform_poses import platform_poses

        return platform_poses(tables, settings)
    from truing.stages.common.belonging import reason_withheld

    empty = {name: ARTIFACTS[name].empty() for name in ("observations", "scans", "measured_poses")}
    sources = {name: tables.get(name, none) for name, none in empty.items()}
    is_empty = not any(table.num_rows for table in sources.values())
    why = (
        NO_BODIES.get(settings.mechanism.type, "no object points")
        if is_empty
        else reason_withheld(tables, of_poses=True)
    )
    if why:
        return Outcome.not_evaluated({name: ARTIFACTS[name].empty() for name in ("poses", "residuals")}, why)
    from truing.stages.rigid_poses.body_poses import body_poses

    return body_poses({**tables, **sources}, settings, progress)
