"""Stage deformation: motion within bodies assumed rigid, and the drive on which it depends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.schemas.mechanism import COLUMNS_OF_AXES, NOISE_OF_COMMANDS
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

DECLARATION = Stage(
    name="deformation",
    reads=(
        *("observations?", "survey?", "configurations?", "poses?", "residuals?"),
        *("readings?", "given_compliance?", "displacement?", "reading_residuals?", "run_terms?", "positions?", "qa?"),
        *(
            "published?",
            "object_points?",
            "point_correlations?",
            "point_sensitivities?",
            "camera_correlations?",
            "given_deformation?",
        ),
    ),
    leaves=(
        *("deformation?", "deformation_models?", "deformation_errors"),
        *("shift_covariances?", "shift_sensitivities?", "survey_covariances?"),
        *("simulated_deformation?", "target_deformation?", "compliance?", "axis_curves?", "positioning?"),
        *("published_compared?", "neglected?", "own_weight?", "tolerance_errors?", "tolerance_samples?"),
    ),
    settings=(
        *("campaign.kind", "campaign.drives", "mechanism.type", "mechanism.legs", "mechanism.height_mm"),
        *(
            "mechanism.elements",
            "mechanism.platform",
            "mechanism.base",
            "mechanism.tolerance",
            "measurement.up",
            "loading",
            "interferometer",
            "noise.load_n",
            "noise.load_nm",
            "exclude",
            *COLUMNS_OF_AXES,
            *NOISE_OF_COMMANDS,
        ),
    ),
    summary="deformation residuals, and linear and matrix models of them",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Fit the deformation models for the campaign's instrument and mechanism."""
    from truing.stages.common.belonging import reason_withheld

    progress(0, 1, "deformation models")
    why = reason_withheld(tables)
    if settings.campaign.kind == "interferometer":  # positions of an axis have nothing to do with loads
        from truing.stages.responses.loads import load_deformation, with_positioning, with_tolerances

        return with_tolerances(with_positioning(load_deformation(tables, settings, why), tables, settings), settings)
    from truing.stages.responses.shifts import shifts_within_bodies

    outcome = shifts_within_bodies(tables, settings, why)
    if settings.mechanism.type != "axis":
        return outcome
    from truing.stages.axis.positioning import with_axis_positioning

    return with_axis_positioning(outcome, tables, settings, why)
