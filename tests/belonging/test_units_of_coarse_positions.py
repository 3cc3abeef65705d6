"""The unit of positions is named where a coarse instrument sees a small range of poses: noise is large in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.stages.line import run_line, settings_of
from truing.belonging.relation import RelationState, RelationTest, SlipKind
from truing.stages.quality.chain_checks import joints_against_links

ROWS = (
    (0.0, -90.0, 400.0),
    (500.0, 0.0, 0.0),
    (50.0, -90.0, 0.0),
    (0.0, 90.0, 450.0),
    (0.0, -90.0, 0.0),
    (0.0, 0.0, 80.0),
)
TOML = """
[campaign]
name = "arm"
kind = "photogrammetry"
[mechanism]
type = "chain"
dh = [{rows}]
[mechanism.tolerance]
offset_deg = 0.3
length_mm = 0.5
angle_deg = 0.05
[measurement]
frame = "campaign"
[noise]
point_mm = 1.0
"""


def _along(angle: float, a: float, alpha: float, d: float) -> np.ndarray:
    """Transform (4, 4) by a standard row of Denavit and Hartenberg, mm and rad."""
    c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0.0, sa, ca, d], [0.0, 0.0, 0.0, 1.0]])


def _tested(folder: Path, factor: float, seed: int) -> RelationTest:
    """The test of an arm with 50 poses within some degrees; positions in mm times a factor are taken as mm."""
    rng = np.random.default_rng(seed)
    center = np.array([0.2, -0.6, 0.5, 0.3, 0.8, -0.4])
    angles, tool = center + rng.uniform(-0.06, 0.06, (50, 6)), np.array([60.0, -30.0, 120.0, 1.0])
    offsets = np.radians(0.3) * rng.normal(size=6)
    places = []
    for pose in angles + offsets:
        T = np.eye(4)
        for angle, (a, alpha, d) in zip(pose, ROWS, strict=True):
            T = T @ _along(angle, a, np.radians(alpha), d)
        places.append((T @ tool)[:3] + rng.normal(size=3))
    numbers = pd.DataFrame({"pose": range(1, 51)})
    folder.mkdir()
    numbers.assign(**{f"joint{k + 1}_rad": angles[:, k] for k in range(6)}).to_csv(
        folder / "configurations.csv", index=False
    )
    columns = dict(zip(("x_mm", "y_mm", "z_mm"), (factor * np.array(places)).T, strict=True))
    numbers.assign(body="tip", target="ball", **columns).to_csv(folder / "points.csv", index=False)
    rows = ", ".join(f"{{ a_mm = {a}, alpha_deg = {alpha}, d_mm = {d} }}" for a, alpha, d in ROWS)
    (folder / "campaign.toml").write_text(TOML.format(rows=rows))
    tables, _ = run_line(folder, "ingest")
    return joints_against_links(tables, settings_of(folder))


@pytest.mark.parametrize(("factor", "seed"), [(1e-3, 1), (0.1, 2), (1.0 / 25.4, 3), (1e3, 4)])
def test_another_unit_is_named_with_its_factor(factor: float, seed: int, tmp_path: Path) -> None:
    tested = _tested(tmp_path / "arm", factor, seed)
    assert tested.state is RelationState.FAILS
    (slip,) = tested.slips
    assert slip.kind is SlipKind.UNIT
    assert slip.factor == pytest.approx(1.0 / factor)


@pytest.mark.parametrize("seed", [5, 6])
def test_positions_in_their_unit_belong_to_the_readings(seed: int, tmp_path: Path) -> None:
    assert _tested(tmp_path / "arm", 1.0, seed).state is RelationState.OK


def test_readings_that_any_positions_would_agree_with_are_not_tested(tmp_path: Path) -> None:
    """Rows in another order: what is left is the whole range of the poses, which tolerances allow."""
    folder = tmp_path / "arm"
    assert _tested(folder, 1.0, 7).state is RelationState.OK
    table = pd.read_csv(folder / "configurations.csv")
    joints = [name for name in table if name != "pose"]
    table[joints] = table[joints].sample(frac=1.0, random_state=1).to_numpy()
    table.to_csv(folder / "configurations.csv", index=False)
    tables, _ = run_line(folder, "ingest")
    tested = joints_against_links(tables, settings_of(folder))
    assert tested.state is not RelationState.OK
