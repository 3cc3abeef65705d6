"""Stereo photographs of a chessboard: calibration of both cameras, and the distance between them.

``python -m tests.real.board_photographs`` writes the tables of docs/photographs.md. Lengths are in squares.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import renew, table
from tests.real.campaigns import PROJECT, data_folder
from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Bars, KnownPoints, Network, Rays
from truing.estimation.bundle.start_values import find_start
from truing.estimation.image_targets.boards import BoardCorners, BoardPlan, measure_board
from truing.formats.image_files import read_grey, read_head

Array = NDArray[np.float64]

FOLDER = "target-images"
PAGE = PROJECT / "docs" / "photographs.md"
SIDES = ("left", "right")
PAIRS = ("01", "04", "07", "10", "13", "16", "19", "22")
BOARD = BoardPlan("board", "chessboard", columns=9, rows=6)
# What was published with the photographs: root mean square of the distances from computed to measured corners.
PUBLISHED_RMS_PX = {"left": 0.153, "right": 0.265}
PUBLISHED_BASE = 3.869
_WIDTH, _HEIGHT = 640, 512
_START_PX = 600.0  # any lens of about 60 degrees
_FREE = ("c", "x0", "y0", "A1", "A2", "B1", "B2")
_FLAT = (1e-6, 1e-6, 1e-6)
# A printed board is true in its plane to a few thousandths of a square; held in the hand, it bends.
_BENT = (0.003, 0.003, 0.03)


def corners_of(side: str, pair: str) -> BoardCorners:
    """The board's corners in one of the photographs."""
    path = data_folder() / FOLDER / f"{side}{pair}.jpg"
    return measure_board(read_grey(path, read_head(path)), BOARD)


@dataclass(frozen=True)
class Calibration:
    """An adjustment of photographs by some cameras; ``bent`` where the shape of the board was estimated with them."""

    adjustment: Adjustment
    sides: tuple[str, ...]
    bent: bool

    @property
    def rms_px(self) -> dict[str, float]:
        """Root mean square of the distances (px) from computed to measured corners, of each camera."""
        network, v = self.adjustment.network, self.adjustment.residuals_px
        camera = network.image_camera[network.rays.image]
        return {side: float(np.sqrt(np.mean(np.sum(v[camera == k] ** 2, 1)))) for k, side in enumerate(self.sides)}

    @property
    def out_of_plane(self) -> float:
        """Root mean square of the board's shape out of its plane, in squares."""
        return float(np.sqrt(np.mean(self.adjustment.state.points[:, 2] ** 2)))

    @property
    def distance_px(self) -> float:
        """The principal distance of the first camera."""
        return float(self.adjustment.state.interior[0, 0])

    @property
    def base(self) -> tuple[float, float]:
        """Distance of the cameras, in squares, with the standard deviation of the mean over the pairs."""
        centre = self.adjustment.state.centre
        length = np.linalg.norm(centre[1::2] - centre[::2], axis=1)
        return float(length.mean()), float(length.std(ddof=1) / np.sqrt(len(length)))


def calibrated(
    corners: dict[tuple[str, str], BoardCorners], sides: tuple[str, ...], pairs: tuple[str, ...], *, bent: bool
) -> Calibration:
    """Cameras, photographs and, where it may be bent, the board, adjusted together."""
    seen = [(side, corners[side, pair]) for pair in pairs for side in sides]
    plane = np.stack([*np.meshgrid(np.arange(9.0), np.arange(6.0)), np.zeros((6, 9))], -1).reshape(-1, 3)
    count = [len(one.number) for _, one in seen]
    rays = Rays(
        image=np.repeat(np.arange(len(seen)), count),
        point=np.concatenate([one.number for _, one in seen]),
        xy_px=np.concatenate([one.xy_px for _, one in seen]),
        cov_px2=np.concatenate([one.cov_px2 for _, one in seen]),
        kind=np.zeros(sum(count), np.int64),
    )
    spread = np.tile(np.diag(np.square(_BENT if bent else _FLAT)), (len(plane), 1, 1))
    network = Network(
        cameras=tuple(Camera(side, _WIDTH, _HEIGHT, 200.0, free=_FREE) for side in sides),
        image_camera=np.array([sides.index(side) for side, _ in seen]),
        image_pose=np.zeros(len(seen), np.int64),
        point_pose=np.zeros(len(plane), np.int64),
        rays=rays,
        bars=Bars.none(),
        known=KnownPoints(np.arange(len(plane)), plane, spread),
    )
    interior = np.zeros((len(sides), 10))
    interior[:, 0] = _START_PX
    return Calibration(adjust(network, find_start(network, interior).state, "known"), sides, bent)


class Facts:
    """Facts of the photographs, each computed once."""

    @cached_property
    def corners(self) -> dict[tuple[str, str], BoardCorners]:
        """The corners of all photographs."""
        return {(side, pair): corners_of(side, pair) for pair in PAIRS for side in SIDES}

    @cached_property
    def flat(self) -> dict[str, Calibration]:
        """Each camera by itself, the board taken for a plane."""
        return {side: calibrated(self.corners, (side,), PAIRS, bent=False) for side in SIDES}

    @cached_property
    def bent(self) -> dict[str, Calibration]:
        """Each camera by itself, the board's shape estimated too."""
        return {side: calibrated(self.corners, (side,), PAIRS, bent=True) for side in SIDES}

    @cached_property
    def together(self) -> tuple[Calibration, ...]:
        """Both cameras by all pairs, by every other one, and by those between."""
        return tuple(calibrated(self.corners, SIDES, pairs, bent=True) for pairs in (PAIRS, PAIRS[::2], PAIRS[1::2]))

    def calibrations(self) -> str:
        """The table of both cameras."""

        def row(name: str, values: dict[str, float], digits: int) -> list[str]:
            return [name, *(f"{values[side]:.{digits}f}" for side in SIDES)]

        sigma0 = {side: float(np.sqrt(one.adjustment.variance_factor)) for side, one in self.bent.items()}
        rows = [
            row("rms as published with the photographs, px", PUBLISHED_RMS_PX, 3),
            row("rms here, the board taken for a plane, px", {s: one.rms_px[s] for s, one in self.flat.items()}, 3),
            row("rms here, the board's shape estimated too, px", {s: one.rms_px[s] for s, one in self.bent.items()}, 3),
            row("board out of its plane, rms, squares", {s: one.out_of_plane for s, one in self.bent.items()}, 4),
            row("sigma0 then, with the stated covariances", sigma0, 2),
            row("principal distance, plane board, px", {s: one.distance_px for s, one in self.flat.items()}, 1),
            row("principal distance, board estimated, px", {s: one.distance_px for s, one in self.bent.items()}, 1),
        ]
        return table(["", *SIDES], rows)

    def base_lines(self) -> str:
        """The table of how far apart the cameras stand."""
        names = ("all eight pairs", "the first, third, ... pair", "the second, fourth, ... pair")
        rows = [["as published with the photographs, from 25 pairs", f"{PUBLISHED_BASE:.3f}", ""]]
        for name, one in zip(names, self.together, strict=True):
            rows.append([name, *(f"{number:.3f}" for number in one.base)])
        return table(["", "base line, squares", "its sigma"], rows)

    @property
    def tables(self) -> dict[str, Callable[[], str]]:
        """The tables of the page."""
        return {"board calibration": self.calibrations, "base line": self.base_lines}


if __name__ == "__main__":
    if not (data_folder() / FOLDER).is_dir():
        sys.exit(f"the photographs are not there: {data_folder() / FOLDER}")
    renew(PAGE, Facts().tables)
