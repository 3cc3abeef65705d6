"""Columns that are numbered as elements of a matrix are poses if their numbers are rigid motions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truing.formats.named_columns import pose_columns

_COUNT = 5


def _motions(seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    motions = np.tile(np.eye(4), (_COUNT, 1, 1))
    motions[:, :3, :3] = Rotation.random(_COUNT, random_state=seed).as_matrix()
    motions[:, :3, 3] = rng.uniform(-900.0, 900.0, (_COUNT, 3))
    return motions


@pytest.mark.parametrize("pattern", ["m_{}{}", "T{}{}", "T[{}][{}]", "H_{}_{}", "tool.r{}{}"])
@pytest.mark.parametrize("first", [0, 1])
def test_elements_in_any_order_keep_their_rows_and_columns(pattern: str, first: int) -> None:
    motions = _motions()
    places = [(row, column) for row in range(4) for column in range(4)]
    order = np.random.default_rng(1).permutation(len(places))
    names = ["theta_1", *(pattern.format(places[k][0] + first, places[k][1] + first) for k in order)]
    values = np.column_stack([np.arange(_COUNT), motions.reshape(_COUNT, 16)[:, order]])
    poses = pose_columns(names, values)
    assert poses is not None
    read = poses.mapping["columns"]
    got = np.stack([values[:, names.index(read[f"m{i}{j}"])] for i, j in places], 1).reshape(-1, 4, 4)
    assert np.array_equal(got, motions)
    assert "theta_1" not in poses.taken


def test_numbers_that_name_the_column_first_are_exchanged() -> None:
    motions = _motions()
    names = [f"T{column}{row}" for row in range(4) for column in range(4)]
    poses = pose_columns(names, motions.reshape(_COUNT, 16))
    assert poses is not None
    assert (poses.mapping["columns"]["m03"], poses.mapping["columns"]["m30"]) == ("T30", "T03")


def test_a_rotation_needs_coordinates_next_to_it() -> None:
    motions = _motions()
    rotation = [f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)]
    cells = motions[:, :3, :3].reshape(_COUNT, 9)
    assert pose_columns(rotation, cells) is None
    beside = pose_columns(["x_m", "y_m", "z_m", *rotation], np.column_stack([motions[:, :3, 3], cells]))
    assert beside is not None
    assert beside.mapping["unit"] == "m"
    assert beside.mapping["columns"]["x_mm"] == "x_m"
    assert beside.mapping["columns"]["m21"] == "r32"
    assert "m03" not in beside.mapping["columns"]


def test_numbers_that_are_no_motion_are_no_pose() -> None:
    motions = _motions()
    motions[:, 0, 0] += 0.2
    names = [f"k{row}{column}" for row in range(4) for column in range(4)]
    assert pose_columns(names, motions.reshape(_COUNT, 16)) is None
