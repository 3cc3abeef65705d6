"""Circular targets are measured in rendered photographs with known centres."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from tests.blind.generator.quaternions import Array
from tests.photographs.field import (
    centres_of_images,
    draw_field,
    holes_of_washers,
    photograph,
    semi_minor_px,
    stand,
)
from tests.photographs.lens import Lens
from tests.photographs.sensor import Sensor
from truing.estimation.image_targets.circles import CirclePlan, measure_circles
from truing.estimation.image_targets.ring_codes import ring_code

LENS = Lens(width_px=1000, height_px=750, focal_px=1300.0)
PLAN = CirclePlan(codes=(ring_code(8), ring_code(12), ring_code(14)))
FIELDS, WHITE_FIELDS = 4, 3
NEAR_HOLE_PX = 1.5  # a hole's edge is lit from one side
NEAR_PX = 0.5  # what is measured farther from a target's centre is something else


@dataclass(frozen=True)
class Measured:
    """All fields together: errors (N, 2) in px and covariance (N, 2, 2) of what was measured of targets, names read
    and true; targets that could not be overlooked, with whether they were found; what was rejected; how many of what
    was measured are codes where there is no target.
    """

    error: Array
    cov: Array
    read: list[str]
    name: list[str]
    plain: dict[tuple[int, int], tuple[str, bool]]
    rejected: Counter[str]
    invented: list[str]


@pytest.fixture(scope="module")
def measured() -> Measured:
    errors, covs, read, name, plain, invented = [], [], [], [], {}, []
    rejected: Counter[str] = Counter()
    for i in range(FIELDS):
        rng = np.random.default_rng([18, i])
        field = draw_field(rng, white=i < WHITE_FIELDS)
        view = stand(rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.7), 800.0, rng.uniform(0, 2 * np.pi))
        found = measure_circles(photograph(field, LENS, view, Sensor(), rng), PLAN)
        centres, minor = centres_of_images(field, LENS, view), semi_minor_px(field, LENS, view)
        apart = np.linalg.norm(found.centre_px[:, None] - centres, axis=-1)
        nearest, right = apart.argmin(axis=1), apart.min(axis=1) < NEAR_PX
        errors.append((found.centre_px - centres[nearest])[right])
        covs.append(found.cov_px2[right])
        read += [found.names[k] for k in np.flatnonzero(right)]
        name += [field.shown[nearest[k]].name for k in np.flatnonzero(right)]
        holes = holes_of_washers(field, LENS, view)
        hole = np.linalg.norm(found.centre_px[:, None] - holes, axis=-1).min(axis=1, initial=np.inf) < NEAR_HOLE_PX
        invented += [found.names[k] for k in np.flatnonzero(~right & ~hole)]
        rejected += found.rejected
        for k in _plainly_seen(centres, minor):
            plain[i, k] = field.shown[k].name, k in nearest[right]
    return Measured(np.concatenate(errors), np.concatenate(covs), read, name, plain, rejected, invented)


def _plainly_seen(centres: Array, minor: Array) -> Iterator[int]:
    """Targets that lie with their rings inside the picture and are not tiny."""
    size = np.array([LENS.width_px, LENS.height_px])
    margin = 6.0 * minor[:, None] + 20.0
    inside = np.all((centres > margin) & (centres < size - margin), axis=1)
    yield from np.flatnonzero(inside & (minor > 3.0)).tolist()


def test_measured_centres_of_circles_are_unbiased(measured: Measured) -> None:
    assert len(measured.error) > 100
    assert np.abs(measured.error.mean(axis=0)).max() < 0.002
    assert np.abs(measured.error).max() < 0.05


def test_centres_scatter_as_the_covariance_says(measured: Measured) -> None:
    chi2 = np.einsum("ni,nij,nj->n", measured.error, np.linalg.inv(measured.cov), measured.error)
    # Standard deviations to a fifth, next to what chance does to as many targets.
    chance = 4 / np.sqrt(len(chi2))
    assert 0.8**2 - chance < chi2.mean() / 2 < 1.2**2 + chance


def test_every_code_that_is_read_is_right(measured: Measured) -> None:
    assert measured.read == measured.name
    assert not any(measured.invented)


def test_few_targets_in_plain_sight_are_overlooked(measured: Measured) -> None:
    found = [seen for _, seen in measured.plain.values()]
    assert len(found) > 80
    assert np.mean(found) > 0.9


def test_rejected_shapes_are_counted_by_reason(measured: Measured) -> None:
    assert all(reason and count > 0 for reason, count in measured.rejected.items())
    assert measured.rejected["at border"] > 0
    # Holes are circles, too, and left to what is known of points; segments of rings, lettering and reflections are not.
    assert len(measured.invented) <= 0.02 * len(measured.read)
