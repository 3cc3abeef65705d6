"""What was measured of a chain: correlated poses, and which frames of the measurement they need."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

from tests.simulation.mechanisms.chains.made_arms import arm, campaign
from tests.tolerance import assert_close
from truing.stages.common.chain_measurements import MeasuredLinks, measured_links, reference_link

COUNT = 4


def _poses(rng: np.random.Generator, body: str = "tip") -> tuple[pa.Table, np.ndarray]:
    """Measured poses of a link, and their full covariances (B, 6, 6), m and rad."""
    half = rng.normal(size=(COUNT, 6, 6)) * np.array([1e-5] * 3 + [1e-4] * 3)[:, None]
    covariance = half @ np.swapaxes(half, -1, -2)
    vectors = rng.normal(size=(COUNT, 6)) * np.array([500.0] * 3 + [0.5] * 3)
    columns = dict(zip(("px_mm", "py_mm", "pz_mm", "rx_rad", "ry_rad", "rz_rad"), vectors.T, strict=True))
    columns |= {f"cov_{i}_{j}": covariance[:, i, j] for i in range(6) for j in range(i, 6)}
    return pa.table({"pose": list(range(COUNT)), "body": [body] * COUNT, **columns}), covariance


def _measured(rng: np.random.Generator, *bodies: str) -> tuple[MeasuredLinks, np.ndarray]:
    tables, covariances = zip(*(_poses(rng, body) for body in bodies), strict=True)
    found = measured_links({"measured_poses": pa.concat_tables(tables)}, arm(), tuple(range(COUNT)))
    return found, covariances[0]


def test_a_position_and_an_orientation_with_covariance_weigh_as_one_pose() -> None:
    rng = np.random.default_rng(3)
    measured, covariance = _measured(rng, "tip")
    own = measured.decoupled()
    away = rng.normal(size=(COUNT, 6)) * 1e-4
    whole = np.einsum("bi,bij,bj->b", away, np.linalg.inv(covariance), away)
    model = campaign(rng, COUNT, 1, orientation=True)
    model = model.at(replace(model.conditions, coupling=measured.coupling))
    parts = model._decoupled(away.reshape(COUNT, 2, 3))
    squares = np.einsum("bki,bkij,bkj->b", parts, np.linalg.inv(own.cov), parts)
    assert_close(squares / whole, np.ones(COUNT), atol=1e-7)
    assert (np.linalg.det(own.cov[:, 0]) < np.linalg.det(measured.cov[:, 0])).all()


def test_measured_poses_need_an_instrument_that_stood_still() -> None:
    measured, _ = _measured(np.random.default_rng(4), "tip", "link2")
    with pytest.raises(ValueError, match="stood still"):
        reference_link(SimpleNamespace(is_frame_fixed=False), measured)  # type: ignore[arg-type]
    assert reference_link(SimpleNamespace(is_frame_fixed=True), measured) is None  # type: ignore[arg-type]
