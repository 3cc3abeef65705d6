"""A bench determines the common error of its sensor's legs, which the pulls take into account."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from tests.simulation.bench.sensor_benches import SIGMA, bench
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.inference.observations import Epochs, Frames, Observations
from truing.inference.pulls import pulls
from truing.simulation.drawn_campaigns import draw_readings


def _fitted(share: float, seed: int) -> FittedModel:
    """The plain fit to a campaign of a sensor whose legs have so much in common."""
    own = bench()
    model = own.model(signals=False)
    readings = draw_readings(model.with_share(share), (), np.random.default_rng(seed))[..., None]
    covariance = np.broadcast_to(SIGMA[:6, None, None] ** 2, (*readings.shape, 1)).copy()
    measured = Observations(readings, covariance, own.is_observed[:, :6])
    return Fitter(model, Epochs(measured, own.conditions, Frames.of_numbers(len(readings))), None, 0).prepared()


@pytest.mark.parametrize(("share", "low", "high", "own"), [(1.0, 0.99, 1.0, False), (0.1, 0.0, 0.5, True)])
def test_the_common_share_of_leg_stiffness_is_estimated(share: float, low: float, high: float, own: bool) -> None:
    """Legs of one make say nothing of their own, and count for no degree of freedom; others do."""
    squares, freedom = 0.0, 0
    for seed in range(3, 9):
        stand = _fitted(share, seed)
        sensor = stand.model.known.sensor
        assert low < sensor.share < high
        place = stand.model.layout["stiffness"]
        found = pulls(stand.fit.shared[place], np.eye(sensor.stiffness_size), stand.covariance()[place, place])
        identified = {
            leg for leg, name in np.array(sensor.unknowns, object)[sensor.geometry_size :][found.identifiable]
        }
        assert (len(identified - {None}) > 0) == own
        squares, freedom = squares + found.chi_square, freedom + found.freedom
    assert chi2.ppf(0.001, freedom) < squares < chi2.ppf(0.999, freedom)
