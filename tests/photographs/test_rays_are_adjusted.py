"""Rays of the generator in the bundle adjustment: the other camera model agrees, and the covariance is the found
scatter."""

from __future__ import annotations

import numpy as np

from tests.blind.generator.quaternions import Array, rotate
from tests.blind.generator.schedule import at_rest, random_moves
from tests.photographs.lens import Lens
from tests.photographs.rays import Photographed, Shooting, draw_rays, true_turns
from tests.tolerance import assert_close
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays, project

MOVES = [at_rest(), *random_moves(2, 0, np.random.default_rng(3))]


def interior(lens: Lens) -> Array:
    """The lens (10,) as parameters of photogrammetry, without balancing."""
    f, (k1, k2, k3), p = lens.focal_px, lens.radial, lens.decentring
    x0, y0 = lens.principal_px.real, lens.principal_px.imag
    return np.array(
        [f, x0, y0, k1 / f**2, k2 / f**4, k3 / f**6, p.real / f, p.imag / f, lens.stretch, lens.shear]
    )  # fmt: skip


def as_network(made: Photographed) -> tuple[Network, NetworkState]:
    """The photographed network and its true state, in m."""
    poses, stations = made.views.centre.shape[:2]
    many = made.points.shape[1]
    camera = tuple(Camera(lens.name, lens.width_px, lens.height_px) for lens in made.shooting.lenses)
    sigma = made.shooting.sigma_px or 0.02
    rays = Rays(
        image=made.pose * stations + made.station,
        point=made.pose * many + made.point,
        xy_px=np.stack([made.pixel.real, made.pixel.imag], axis=-1),
        cov_px2=np.broadcast_to(sigma**2 * np.eye(2), (len(made.pixel), 2, 2)).copy(),
        kind=np.zeros(len(made.pixel), np.int64),
    )
    network = Network(
        cameras=camera,
        image_camera=np.tile(np.arange(stations) % len(camera), poses),
        image_pose=np.repeat(np.arange(poses), stations),
        point_pose=np.repeat(np.arange(poses), many),
        rays=rays,
        bars=_bars(made, many),
        known=KnownPoints.none(),
    )
    turn = true_turns(made).reshape(-1, 4)
    R = np.stack([rotate(turn, np.tile(axis, (len(turn), 1))) for axis in np.eye(3)], axis=-1)
    state = NetworkState(
        interior=np.stack([interior(lens) for lens in made.shooting.lenses]),
        R=R,
        centre=1e-3 * made.views.centre.reshape(-1, 3),
        points=1e-3 * made.points.reshape(-1, 3),
        bar_length_m=1e-3 * np.array([bar.length_mm for bar in made.shooting.bars]),
    )
    return network, state


def _bars(made: Photographed, many: int) -> Bars:
    poses, count = len(made.points), len(made.shooting.bars)
    first = many - 2 * count + 2 * np.arange(count) + many * np.arange(poses)[:, None]
    return Bars(
        bar=np.tile(np.arange(count), poses),
        first=first.ravel(),
        second=first.ravel() + 1,
        repeat_sigma_m=np.zeros(poses * count),
        length_m=1e-3 * made.calibrated_mm,
        sigma_m=1e-3 * np.array([bar.sigma_mm for bar in made.shooting.bars]),
    )


def test_both_formulations_of_a_lens_image_alike() -> None:
    exact = Shooting(sigma_px=0.0, gross_share=0.0, lenses=(Lens("one"), Lens("two", radial=(-0.2, 0.3, -0.4))))
    network, state = as_network(draw_rays(exact, MOVES, [], [], np.random.default_rng(11)))
    imaged = project(network, state, network.rays.image, network.rays.point)
    assert_close(imaged, network.rays.xy_px, atol=1e-8, what="image coordinates (px)")


def test_points_scatter_about_the_truth_as_their_covariance_says() -> None:
    shooting = Shooting(gross_share=0.0)
    network, truth = as_network(draw_rays(shooting, MOVES, [], [], np.random.default_rng(12)))
    found = adjust(network, truth)
    assert found.converged
    assert abs(found.variance_factor - 1) < 4 * np.sqrt(2 / found.redundancy)
    # In the free datum what is found differs from the truth by no shift and no turn; bars give the length.
    off = (found.state.points - truth.points)[network.point_pose == 1].ravel()
    spectrum, axes = np.linalg.eigh(found.covariance.points(1))
    determined = spectrum > 1e-9 * spectrum.max()
    freedom = int(determined.sum())
    assert freedom == len(off) - 6
    chi2 = np.sum((axes.T @ off)[determined] ** 2 / spectrum[determined])
    assert abs(chi2 - freedom) < 4 * np.sqrt(2 * freedom)
