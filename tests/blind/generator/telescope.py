"""The sample campaign: the report's telescope, its 46 configurations, and its platform deformed by the
published K.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.certificate import certificate_lines
from tests.blind.generator.effects import MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Surroundings
from tests.blind.generator.schedule import at_rest, published_moves

SEED = 20090421
PUBLISHED_K = 1e-3 * np.array(
    [
        [16, 0, -8, 12, -2, -20],
        [0, 20, -17, -1, 13, -13],
        [-2, -15, 14, 2, -9, 9],
        [6, -12, 4, 14, -16, 2],
        [-12, 7, 0, -15, 14, 4],
        [-20, -1, 10, -10, 2, 19],
    ],
    float,
)
ASSUMED_PARTS = (
    "",
    "[mechanism.flexure]",
    "diameter_mm = 2.0",
    "youngs_gpa = 114.0",
    "poisson = 0.34",
    "",
    "[mechanism.leg_tube]",
    "diameter_mm = 12.0",
    "youngs_gpa = 150.0",
    "poisson = 0.30",
)
RANGES = (
    "",
    "[workspace]",
    "x_mm = 1.0",
    "y_mm = 1.0",
    "z_mm = 0.1",
    "rx_deg = 0.5",
    "ry_deg = 0.5",
    "rho_mm = 1.3",
    "",
    "[requirement]",
    "x_mm = 0.1",
    "y_mm = 0.1",
    "z_mm = 0.01",
    "rx_deg = 0.05",
    "ry_deg = 0.05",
)
LAYOUT = Layout(
    name="telescope",
    faults=DataFaults(missing_share=0.01, gross_share=0.005, gross_mm=(0.1, 3.0)),
    surroundings=Surroundings(frame_turn_rad=0.1, frame_shift_mm=30.0),
    certificate=certificate_lines(
        "hexapod of a telescope, simulated", "photogrammetry, simulated", "2026-11-21", "2026-11-21"
    ),
    further_sections=(*ASSUMED_PARTS, *RANGES),
)


def telescope_campaign(layout: Layout = LAYOUT, seed: int = SEED) -> Campaign:
    """The sample campaign in memory: the reference configuration, then the poses of tables 3 and 4 in the
    report's order.
    """
    moves = [at_rest(), *published_moves()]
    return draw_campaign(layout, moves, [MatrixDeformation(PUBLISHED_K)], np.random.default_rng(seed))


def write_telescope(folder: Path) -> Path:
    """Writes the sample campaign into ``folder``; the same bytes every time."""
    return write_campaign(telescope_campaign(), folder, SEED)
