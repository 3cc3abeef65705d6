"""Scale of photographs without a visible bar, and what is reported of unseen bars."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pyarrow as pa
import pytest

from truing.schemas.photographs import Board
from truing.stages.bundle_adjustment.survey_distances import unobserved_bars, with_scale

NO_FILES: Any = SimpleNamespace(entries=lambda table: ())
CORNERS = [f"plate/M.{corner}" for corner in range(4)]
BAR = {"bar": "S", "first": "a", "second": "b", "length_mm": 300.0, "sigma_mm": 0.01, "repeat_sigma_mm": 0.0}
MARKER = pa.Table.from_pylist([{"family": "aruco4x4_50", "code": 1, "body": "plate", "target": "M", "size_mm": 30.0}])


def rays(**points: list[str]) -> pa.Table:
    return pa.Table.from_pylist([{"pose": pose, "point": point} for pose, own in points.items() for point in own])


def bars(serves: str = "scale") -> pa.Table:
    return pa.Table.from_pylist([{**BAR, "serves": serves}])


def scaled(
    image_points: pa.Table, scale_bars: pa.Table, noise_mm: float | None = 0.02, boards: tuple[Board, ...] = ()
) -> list[dict[str, Any]]:
    tables = {"image_points": image_points, "scale_bars": scale_bars, "image_targets": MARKER}
    settings: Any = SimpleNamespace(
        photographs=SimpleNamespace(datum="free", marker_mm=None, boards=boards),
        noise=SimpleNamespace(point_mm=noise_mm),
        files=SimpleNamespace(targets=()),
    )
    found = with_scale(tables, settings, NO_FILES)
    return [row for row in found["scale_bars"].to_pylist() if row["bar"] != "S"]


def test_a_bar_that_is_seen_is_the_scale() -> None:
    assert scaled(rays(p=["a", "b", *CORNERS]), bars()) == []


@pytest.mark.parametrize("scale_bars", [bars(), bars("check")])
def test_without_a_bar_the_diagonals_of_markers_give_the_scale(scale_bars: pa.Table) -> None:
    first, second = scaled(rays(p=["a", *CORNERS]), scale_bars)
    assert (first["first"], first["second"], second["first"]) == ("plate/M.0", "plate/M.2", "plate/M.1")
    assert first["length_mm"] == pytest.approx(30.0 * 2**0.5)
    assert first["sigma_mm"] == pytest.approx(0.02 * 2**0.5)
    first, _ = scaled(rays(p=["a", *CORNERS]), scale_bars, noise_mm=None)
    assert first["sigma_mm"] == pytest.approx(0.03 * 2**0.5)
    assert scaled(rays(p=["a", *CORNERS[:3]]), scale_bars) == []


def test_diagonals_of_boards_between_corners_seen_in_all_poses_give_the_scale() -> None:
    board = Board(name="floor", kind="chessboard", columns=5, rows=4, square_mm=10.0)
    whole = [f"floor-{n}" for n in range(20)]
    without_a_corner = [name for name in whole if name != "floor-4"]
    first, second = scaled(rays(p=whole, q=["x"]), bars(), noise_mm=None, boards=(board,))
    assert (first["first"], first["second"], second["first"], second["second"]) == tuple(
        f"floor-{n}" for n in (0, 19, 4, 15)
    )
    assert first["length_mm"] == pytest.approx(50.0)
    assert first["sigma_mm"] == pytest.approx(0.05)
    first, _ = scaled(rays(p=whole, q=without_a_corner), bars(), boards=(board,))
    assert (first["first"], first["second"]) == ("floor-6", "floor-13")
    assert first["length_mm"] == pytest.approx(10.0 * 5**0.5)
    assert scaled(rays(p=["a"]), bars(), boards=(board,)) == []


def test_marker_diagonals_give_the_scale_only_in_poses_without_a_bar() -> None:
    found = scaled(rays(p=["a", "b"], q=["a", *CORNERS], r=CORNERS), bars())
    assert sorted({row["pose"] for row in found}) == ["q", "r"]


def test_bars_that_no_image_shows_are_reported() -> None:
    assert unobserved_bars(bars(), rays(p=["a"])) == ["scale bar S: no image shows b"]
    assert unobserved_bars(bars(), rays(p=["a"], q=["b"])) == ["scale bar S: no pose shows both ends"]
    assert unobserved_bars(bars(), rays(p=["a", "b"])) == unobserved_bars(None, rays(p=["a"])) == []
