"""Large networks: written correlations, points used for poses, and the predicted cost of a run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tests.stages.line import settings_of
from truing.estimation.bundle import row_blocks
from truing.estimation.bundle.cost import adjustment_cost
from truing.formats.source import CampaignFiles
from truing.pipeline.in_memory import call_stage
from truing.stages.bundle_adjustment import paired_points
from truing.stages.ingestion.adjusted_points import UNPAIRED
from truing.stages.ingestion.adjusted_points import paired_points as is_paired

_PAIR = ["pose", "point", "other_point"]
_RAYS = ("image_points", "photographs", "image_targets", "scale_bars", "known_points", "cameras_given")


@pytest.fixture(scope="module")
def large(adjusted: Any) -> dict[str, pa.Table]:
    """The campaign adjusted as if its poses were large: ray by ray, with pairs of twelve points a pose."""
    _, folder, tables = adjusted
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(row_blocks, "MOST_DENSE_POINTS", 0)
        patched.setattr(paired_points, "MOST_PAIRED", 8)
        patched.setattr(paired_points, "SPREAD", 12)
        patched.setattr(paired_points, "_LEAST_OF_BODY", 4)
        given = {name: tables[name] for name in _RAYS if name in tables}
        settings = settings_of(folder)
        found = call_stage("bundle", given, settings, CampaignFiles(folder, settings))
    return found.artifacts  # type: ignore[return-value]


def test_points_and_their_uncertainty_are_those_of_the_dense_adjustment(adjusted: Any, large: Any) -> None:
    reference, found = (t["object_points"].to_pandas() for t in (adjusted[2], large))
    assert (found[["pose", "point"]] == reference[["pose", "point"]]).all(axis=None)
    for name in ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm"):
        np.testing.assert_allclose(found[name], reference[name], rtol=1e-7)
    for name in ("image_orientations", "image_residuals", "cameras", "point_sensitivities", "ray_effects"):
        ours, theirs = large[name].to_pandas(), adjusted[2][name].to_pandas()
        for column in ours.select_dtypes(float):
            scale = np.nanmax(np.abs(theirs[column]), initial=1e-300)
            np.testing.assert_allclose(ours[column] / scale, theirs[column] / scale, rtol=0, atol=1e-6, err_msg=column)


def test_pairs_that_are_written_are_those_of_all_pairs(adjusted: Any, large: Any) -> None:
    reference, found = (t["point_correlations"].to_pandas() for t in (adjusted[2], large))
    both = found.merge(reference, on=_PAIR, suffixes=("", "_all"))
    assert 0 < len(found) == len(both) < len(reference) / 2
    for name in reference.columns.difference(_PAIR):
        np.testing.assert_allclose(both[name], both[f"{name}_all"], rtol=0, atol=1e-6)


def test_points_without_pairs_do_not_go_to_poses(adjusted: Any, large: Any) -> None:
    _, folder, tables = adjusted
    paired = is_paired(large["object_points"], large["point_correlations"])
    assert 0 < paired.sum() < len(paired)
    assert is_paired(tables["object_points"], tables["point_correlations"]).all()
    given = {name: large[name] for name in ("object_points", "point_correlations")}
    settings = settings_of(folder)
    outcome = call_stage(
        "ingest", {**given, "scale_bars": tables["scale_bars"]}, settings, CampaignFiles(folder, settings)
    )
    names = set(large["object_points"].column("point").filter(pa.array(paired)).to_pylist())
    observed = outcome.artifacts["observations"]
    assert isinstance(observed, pa.Table)
    assert observed.num_rows > 0
    assert set(observed.column("point").to_pylist()) <= names
    assert UNPAIRED in str(outcome.left_out)


def test_the_cost_grows_with_rays_and_not_with_the_square_of_points() -> None:
    one, other = (adjustment_cost(np.array([60]), np.array([n]), np.array([3 * n])) for n in (20_000, 40_000))
    assert other.seconds < 2.1 * one.seconds
    assert other.bytes < 2.1 * one.bytes
    assert one.bytes < 2e9
    whole = adjustment_cost(np.array([60]), np.array([1000]), np.array([60_000]))
    assert whole.bytes > 8 * 9 * 1000**2  # the joint covariance of all points
