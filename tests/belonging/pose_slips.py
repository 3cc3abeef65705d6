"""Slips in the points of some poses; shares no code with what finds them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.belonging.point_slips import Change, Files, PointSlip, Rows, stretch_of_rows

_XYZ = ["x_mm", "y_mm", "z_mm"]


def _points_in_rows(chosen: Rows, change: Change, *bodies: str) -> Callable[[Files], None]:
    """A change in the points of some poses, of all bodies or some; change takes the rows of points."""

    def make(files: Files) -> None:
        poses = files.configurations["pose"].to_numpy()[chosen(np.arange(len(files.configurations)))]
        rows = files.points["pose"].isin(poses) & files.points["body"].isin(bodies or files.points["body"].unique())
        change(files, rows.to_numpy())

    return make


def _points_on_a_day(change: Change, *bodies: str) -> Callable[[Files], None]:
    def make(files: Files) -> None:
        day = 1 + np.arange(len(files.configurations)) // 3 % 3
        files.configurations["day"] = day
        _points_in_rows(lambda rows: day == 2, change, *bodies)(files)

    return make


def _points_inch(files: Files, rows: np.ndarray) -> None:
    files.points.loc[rows, _XYZ] /= 25.4


def _points_m(files: Files, rows: np.ndarray) -> None:
    files.points.loc[rows, _XYZ] *= 1e-3


def _x_turned(files: Files, rows: np.ndarray) -> None:
    files.points.loc[rows, "x_mm"] *= -1.0


def _xy_exchanged(files: Files, rows: np.ndarray) -> None:
    files.points.loc[rows, ["x_mm", "y_mm"]] = files.points.loc[rows, ["y_mm", "x_mm"]].to_numpy()


def _labels_of_bodies(files: Files, rows: np.ndarray) -> None:
    bodies = files.points.loc[rows, "body"].replace({"base": "platform", "platform": "base"})
    files.points.loc[rows, "body"] = bodies


def _odd(rows: np.ndarray) -> np.ndarray:
    return rows % 2 == 1


_SURVEY = "points-against-survey"
POSE_SLIPS = (
    PointSlip("points in inches in a stretch", "unit", _points_in_rows(stretch_of_rows, _points_inch), _SURVEY),
    PointSlip("platform in m in every second pose", "unit", _points_in_rows(_odd, _points_m, "platform"), _SURVEY),
    PointSlip(
        "platform mirrored in a stretch", "mirrored", _points_in_rows(stretch_of_rows, _x_turned, "platform"), _SURVEY
    ),
    PointSlip("points mirrored in every second pose", "mirrored", _points_in_rows(_odd, _x_turned), _SURVEY),
    PointSlip("points mirrored on a day", "mirrored", _points_on_a_day(_x_turned), _SURVEY),
    PointSlip(
        "axes of the base exchanged in a stretch",
        "mirrored",
        _points_in_rows(stretch_of_rows, _xy_exchanged, "base"),
        _SURVEY,
    ),
    PointSlip("axes exchanged on a day", "mirrored", _points_on_a_day(_xy_exchanged, "platform"), _SURVEY),
    PointSlip(
        "bodies exchanged in a stretch", "mislabelled", _points_in_rows(stretch_of_rows, _labels_of_bodies), _SURVEY
    ),
    PointSlip(
        "bodies exchanged in every second pose", "mislabelled", _points_in_rows(_odd, _labels_of_bodies), _SURVEY
    ),
)
