"""Height at which lengths from photographs are unbiased: that of the scale bars."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from truing.estimation.rotation import exp_so3
from truing.inference.observations import Epochs, Frames, Observations
from truing.simulation.mechanisms.recording import Conditions
from truing.stages.diagnosis.ray_points import scale_height

RNG = np.random.default_rng(4)
INSIDE = RNG.normal(size=(6, 3))  # four ends of bars and two targets, in the model's frame, m
TURN, SHIFT = exp_so3(RNG.normal(size=(3, 3))), RNG.normal(size=(3, 3))
MEASURED = np.einsum("bij,kj->bki", TURN, INSIDE) + SHIFT[:, None]
NAMES = ("S1", "S2", "T1", "T2", "P1", "P2")


def poses() -> Epochs:
    points = MEASURED[:, 4:].copy()
    is_observed = np.array([[True, True], [True, True], [True, False]])
    points[~is_observed] = np.nan
    conditions = Conditions(np.zeros((3, 0)), poses=(1, 2, 3))
    measured = Observations(points, np.ones((3, 2, 1, 1)) * np.eye(3), is_observed)
    return Epochs(measured, conditions, Frames(TURN, SHIFT))


def tables(serves: tuple[str, str]) -> dict[str, pa.Table]:
    rows = [
        {"pose": pose + 1, "point": name, **dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * place, strict=True))}
        for pose, places in enumerate(MEASURED)
        for name, place in zip(NAMES, places, strict=True)
    ]
    bars = {
        "first": ["S1", "T1"],
        "second": ["S2", "T2"],
        "length_mm": [1000.0, 500.0],
        "sigma_mm": [0.01, 0.0],
        "repeat_sigma_mm": [0.0, 0.01],
        "serves": serves,
    }
    return {"object_points": pa.Table.from_pylist(rows), "scale_bars": pa.table(bars)}


@pytest.mark.parametrize(("serves", "share"), [(("scale", "scale"), 0.8), (("scale", "check"), 1.0)])
def test_bars_count_as_their_calibration_does_in_the_scale(serves: tuple[str, str], share: float) -> None:
    first, second = INSIDE[:2, 2].mean(), INSIDE[2:4, 2].mean()
    assert scale_height(tables(serves), poses()) == pytest.approx(share * first + (1 - share) * second)


def test_without_bars_the_scale_is_right_amid_the_points() -> None:
    expected = (3 * INSIDE[4, 2] + 2 * INSIDE[5, 2]) / 5
    assert scale_height(tables(("check", "check")), poses()) == pytest.approx(expected)
    assert scale_height({}, poses()) == pytest.approx(expected)
