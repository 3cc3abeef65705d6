"""Legs of a sensor as chains, by command line, against the joints of campaign.toml and elementary motions."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.second_hand.command import call

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "force-sensor"
XYZ = ["x", "y", "z"]
LIFT = np.array([0.0, 0.0, 300.0])


@pytest.fixture(scope="module")
def chains(tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, pd.DataFrame, list[dict[str, list[float]]]]:

    place = tmp_path_factory.mktemp("chains") / "t.csv"
    call("design", SAMPLE, "--tolerances", "--out", place)
    legs = tomllib.loads((SAMPLE / "campaign.toml").read_text(encoding="utf-8"))["mechanism"]["legs"]
    return pd.read_csv(place.with_name("t-links.csv")), pd.read_csv(place.with_name("t-influence.csv")), legs


def _vectors(own: pd.DataFrame, name: str, ending: str = "") -> np.ndarray:
    return own[[f"{name}_{c}{ending}" for c in XYZ]].to_numpy()


def test_links_join_the_base_to_the_platform(chains) -> None:
    links, _, legs = chains
    for leg, joints in enumerate(legs, start=1):
        own = links[links["leg"] == leg].set_index("link")
        B, b = np.array(joints["B_mm"]), np.array(joints["b_mm"]) + LIFT
        corner = _vectors(own, "corner", "_mm")
        np.testing.assert_allclose(corner[[0, 3]], [B, b], atol=1e-6)
        np.testing.assert_allclose(corner[6], [0.0, 0.0, 300.0], atol=1e-6)  # back to the platform's axis
        assert own.loc[1, "length_mm"] == pytest.approx(np.hypot(*B[:2]))
        assert own.loc[7, "length_mm"] == pytest.approx(np.hypot(*b[:2]))
        assert own.loc[3, "offset_mm"] == pytest.approx(np.linalg.norm(b - B))
        np.testing.assert_allclose(_vectors(own, "axis")[2], (b - B) / np.linalg.norm(b - B), atol=1e-8)


def test_angles_turn_one_normal_and_one_axis_into_the_next(chains) -> None:
    """Rodrigues' rotation by the tabled angle about the tabled vector (eq. 6, 7 and 12)."""
    links, _, _ = chains
    for _, own in links.groupby("leg"):
        axis, normal = _vectors(own, "axis"), _vectors(own, "normal")
        for j in range(6):
            for about, turned, into, angle in (
                (axis[j], normal[j], normal[j + 1], own["angle_deg"].iloc[j]),
                (normal[j + 1], axis[j], axis[j + 1], own["twist_to_next_deg"].iloc[j]),
            ):
                c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
                moved = c * turned + s * np.cross(about, turned) + (1 - c) * (about @ turned) * about
                np.testing.assert_allclose(moved, into, atol=1e-7)
                assert abs(about @ turned) < 1e-7


def test_one_micrometre_on_one_leg_moves_the_end_of_its_chain(chains) -> None:
    """Lengths shift the platform along their own direction and turn nothing (eq. 10 and 13)."""
    _, influence, legs = chains
    for leg, joints in enumerate(legs, start=1):
        own = influence[influence["leg"] == leg].set_index("error_source")
        B, b = np.array(joints["B_mm"]), np.array(joints["b_mm"])
        along = b + LIFT - B
        ways = {"base_radius": B * [1, 1, 0], "platform_radius": -b * [1, 1, 0], "sensor_installation": along}
        ways |= {"lower_clearance": along, "middle_clearance": -along}
        for source, way in ways.items():
            shift = own.loc[source, ["x_um", "y_um", "z_um"]].to_numpy(float)
            np.testing.assert_allclose(shift, way / np.linalg.norm(way), atol=1e-7)
            assert not own.loc[source, ["rx_arcsec", "ry_arcsec", "rz_arcsec"]].any()
