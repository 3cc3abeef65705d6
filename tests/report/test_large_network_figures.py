"""Figures of large networks show a sample of points and images, and say so."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from truing.report.photographs import figures


def _residuals(images: int, rays: int) -> pd.DataFrame:
    rng = np.random.default_rng(1)
    count = images * rays
    values = {name: rng.uniform(0, 3000, count) for name in ("x_px", "y_px")}
    values |= {name: rng.normal(size=count) for name in ("vx_px", "vy_px")}
    image = np.repeat([f"I{n}" for n in range(images)], rays)
    return pd.DataFrame({"pose": 1, "image": image, "camera": "c", "point": "P", "rejected": False, **values})


@pytest.mark.parametrize(("images", "rays", "shown"), [(10, 20, 10), (60, 20, 40), (8, 5000, 4), (2, 30_000, 1)])
def test_images_are_shown_up_to_a_number_of_rays(images: int, rays: int, shown: int) -> None:
    assert len(figures._shown_images(_residuals(images, rays))) == shown


def test_points_of_every_uncertainty_are_shown_and_the_worst_among_them() -> None:
    sigma = np.random.default_rng(2).uniform(0.1, 1.0, 10_000)
    points = pd.DataFrame({"pose": 1, **{f"sigma_{a}_mm": sigma for a in "xyz"}})
    shown = figures._shown_points(points)
    assert len(shown) == figures._MOST_POINTS
    assert shown["sigma_x_mm"].max() == sigma.max()
    assert abs(shown["sigma_x_mm"].median() - np.median(sigma)) < 0.01
    assert len(figures._shown_points(points.head(100))) == 100
