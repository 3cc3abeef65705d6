"""Shifts of single targets from photographs: correlated errors are weighted in the response to a drive."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from truing.estimation.deformation import correlated_residuals
from truing.stages.responses.shifts import framed_bodies, framed_points, target_deformation

Tables = dict[str, pa.Table]

POSES = 8


@pytest.fixture(scope="module")
def some(drawn: Tables) -> Tables:
    """Some of the poses, each with a drive that nothing follows."""
    tables = {
        name: table.filter(pc.less_equal(table.column("pose"), POSES)) if "pose" in table.column_names else table
        for name, table in drawn.items()
    }
    drive = pa.array(np.random.default_rng(1).normal(size=POSES))
    return tables | {"configurations": tables["configurations"].append_column("load_n", drive)}


def test_a_drive_without_response_is_reported_as_far_as_weights_allow(some: Tables) -> None:
    found = target_deformation(some, ("load_n",)).artifacts
    models, shifts = (found[name].to_pandas() for name in ("deformation_models", "target_deformation"))  # type: ignore[union-attr]
    squares = (models["coefficient"] / models["sigma"]) ** 2
    freedom = len(squares) - 12  # two frames were fitted to them
    assert abs(squares.mean() - 1.0) < 4.0 * np.sqrt(2 / freedom)
    unweighted = _slopes(shifts, some["configurations"].to_pandas().set_index("pose")["load_n"])
    assert np.sqrt((models["coefficient"] ** 2).mean()) < 1.2 * np.sqrt((unweighted**2).mean())


def _slopes(shifts: pd.DataFrame, drive: pd.Series) -> np.ndarray:
    dense = shifts.pivot(index="pose", columns=["body", "target", "axis"], values="displacement_um")
    u = (drive - drive.mean()).loc[dense.index].to_numpy()
    return np.asarray(u @ (dense - dense.mean()).to_numpy() / (u @ u))


def test_residuals_of_all_targets_scatter_together_as_stated(drawn: Tables) -> None:
    poses = tuple(range(1, 101))
    framed = framed_points(drawn, poses)
    assert framed is not None
    reported = correlated_residuals(framed)
    left_out = drawn["residuals"].to_pandas().groupby("pose")["rejected"].any()
    whole = ~left_out.to_numpy()  # few have lost a target as a gross error, and have another frame
    assert whole.mean() > 0.9
    for body in ("base", "platform"):
        rows = drawn["residuals"].to_pandas().query("body == @body")
        dense = rows.pivot(index="pose", columns="target", values=["dx_mm", "dy_mm", "dz_mm"]).swaplevel(axis=1)
        targets = tuple(dense.columns.get_level_values(0).unique())
        off = 1e-3 * dense[[(t, f"d{a}_mm") for t in targets for a in "xyz"]].to_numpy()
        off = off[whole] - off[whole].mean(0)
        noise, there = reported(body, targets)
        assert there.all()
        values, vectors = np.linalg.eigh(noise[np.flatnonzero(whole)[0]])
        kept = values > 0
        squares = np.sum((off @ vectors[:, kept]) ** 2 / values[kept], axis=1)
        assert kept.sum() >= len(values) - 6
        assert abs(squares.mean() / kept.sum() - 1.0) < 4.0 * np.sqrt(2 / (kept.sum() * len(off)))


def test_a_shape_without_survey_is_what_residuals_were_counted_from(some: Tables) -> None:
    poses = tuple(range(1, POSES + 1))
    surveyed = framed_bodies(some, poses)
    alone = framed_bodies({name: table for name, table in some.items() if name != "survey"}, poses)
    for one, other in zip(alone, surveyed, strict=True):
        place = [other.targets.index(target) for target in one.targets]
        used = one.used.any(axis=0)
        np.testing.assert_allclose(one.source[used], other.source[place][used], atol=1e-12)
        assert not one.cov_source.any()
