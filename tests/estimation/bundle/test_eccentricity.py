"""The eccentricity of a circle's image agrees with the projected circle, and normals follow from ellipses."""

from __future__ import annotations

import numpy as np

from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.eccentricity import eccentricity, facing, network_eccentricity
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays

CENTRE = np.array([1999.5, 1499.5])
IDEAL = np.array([4000.0, 12.0, -7.0, 0, 0, 0, 0, 0, 0, 0])
REAL = np.array([4000.0, 12.0, -7.0, -2.5e-9, 3e-16, 0, 4e-7, -3e-7, 1e-4, -2e-4])


def pinhole(interior, X):
    """Image coordinates (..., 2) by the equations of the camera, written out once more."""
    c, x0, y0, a1, a2, _, b1, b2, c1, c2 = interior
    x, y = c * X[..., 0] / X[..., 2], c * X[..., 1] / X[..., 2]
    r2 = x**2 + y**2
    bend = a1 * r2 + a2 * r2**2
    u = CENTRE[0] + x0 + x + x * bend + b1 * (r2 + 2 * x**2) + 2 * b2 * x * y + c1 * x + c2 * y
    v = CENTRE[1] + y0 + y + y * bend + b2 * (r2 + 2 * y**2) + 2 * b1 * x * y
    return np.stack([u, v], -1)


def circle(P, n, radius, count=720):
    side = np.cross(n, [0.3, -0.5, 0.8])
    side = side / np.linalg.norm(side)
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False)[:, None]
    return P + radius * (np.cos(turn) * side + np.sin(turn) * np.cross(n, side))


def fitted_ellipse(points):
    """Centre, semi-axes and angle of the ellipse of least algebraic distance, after moving and scaling the points."""
    mean, size = points.mean(0), points.std()
    x, y = ((points - mean) / size).T
    conic = np.linalg.svd(np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], 1), full_matrices=False)[2][-1]
    A = np.array([[conic[0], conic[1] / 2], [conic[1] / 2, conic[2]]])
    middle = -np.linalg.solve(2 * A, conic[3:5])
    values, vectors = np.linalg.eigh(A / (middle @ A @ middle - conic[5]))
    axes = size / np.sqrt(values)
    return mean + size * middle, axes, np.arctan2(vectors[1, 0], vectors[0, 0])


def scenes(rng, count):
    """Circles of 3 to 20 mm seen from about 1 m at tilts up to 65 degrees."""
    for _ in range(count):
        P = np.array([*rng.uniform(-0.35, 0.35, 2), rng.uniform(0.8, 1.5)])
        tilt, turn = rng.uniform(0, np.radians(65)), rng.uniform(0, 2 * np.pi)
        sight = -P / np.linalg.norm(P)
        side = np.cross(sight, [np.cos(turn), np.sin(turn), 0.2])
        n = np.cos(tilt) * sight + np.sin(tilt) * side / np.linalg.norm(side)
        yield P, n / np.linalg.norm(n), rng.uniform(0.0015, 0.01)


def all_at_once(interior, cases):
    P, n, radius = (np.array(v) for v in zip(*cases, strict=True))
    k = len(P)
    return eccentricity(np.tile(interior, (k, 1)), np.tile(CENTRE, (k, 1)), np.zeros(k), P, n, radius)


def projected(interior, P, n, radius):
    return fitted_ellipse(pinhole(interior, circle(P, n, radius)))[0] - pinhole(interior, P)


def test_without_distortion_it_is_exact():
    cases = list(scenes(np.random.default_rng(1), 40))
    expected = np.array([projected(IDEAL, *case) for case in cases])
    assert np.abs(expected).max() > 0.1  # px: there is something to correct
    np.testing.assert_allclose(all_at_once(IDEAL, cases), expected, atol=1e-7)


def test_with_distortion_it_is_good_to_a_thousandth_of_a_pixel():
    cases = list(scenes(np.random.default_rng(2), 40))
    expected = np.array([projected(REAL, *case) for case in cases])
    np.testing.assert_allclose(all_at_once(REAL, cases), expected, atol=1e-3)
    assert np.abs(expected - all_at_once(IDEAL, cases)).max() > 0.003  # distortion does count


def test_the_sign_of_the_normal_does_not_matter_and_a_circle_facing_the_camera_has_none():
    P, n, radius = np.array([0.1, 0.2, 1.0]), np.array([0.3, -0.4, -0.866]), 0.01
    n = n / np.linalg.norm(n)
    both = all_at_once(REAL, [(P, n, radius), (P, -n, radius)])
    np.testing.assert_allclose(both[0], both[1], atol=1e-9)
    straight = all_at_once(IDEAL, [(np.array([0.2, 0.1, 1.0]), np.array([0, 0, -1.0]), radius)])
    np.testing.assert_allclose(straight, 0, atol=1e-8)  # parallel to the image plane: any circle's image is a circle


def test_a_circle_seen_edge_on_or_from_behind_has_no_ellipse():
    edge_on = (np.array([0.0, 0.0, 1.0]), np.array([1.0, 0, 0]), 0.01)
    behind = (np.array([0.0, 0.0, -1.0]), np.array([0, 0, 1.0]), 0.01)
    assert np.isnan(all_at_once(IDEAL, [edge_on, behind])).all()


def looking(centre, target):
    z = (target - centre) / np.linalg.norm(target - centre)
    x = np.cross([0.1, 1.0, 0.2], z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], 1)


def network_of(rng, images, points):
    """Circles near the origin with normals about z, photographed from a cap above: network, state, normals, radius."""
    direction = np.stack([rng.uniform(-0.7, 0.7, images), rng.uniform(-0.7, 0.7, images), np.ones(images)], 1)
    centre = 1.2 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    R = np.stack([looking(c, np.zeros(3)) for c in centre])
    xyz = rng.uniform(-0.1, 0.1, (points, 3))
    n = rng.normal((0, 0, 1), 0.3, (points, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    image, point = (v.ravel() for v in np.meshgrid(np.arange(images), np.arange(points), indexing="ij"))
    camera = Camera("one", 4000, 3000)
    rays = Rays(image, point, np.zeros((len(image), 2)), np.tile(np.eye(2), (len(image), 1, 1)), np.zeros_like(image))
    network = Network(
        (camera,), np.zeros(images, int), np.zeros(images, int), np.zeros(points, int), rays, Bars.none(),
        KnownPoints.none(),
    )  # fmt: skip
    return network, NetworkState(REAL[None], R, centre, xyz, np.empty(0)), n, 0.004


def ellipses(network, state, n, radius, rng, sigma):
    """Ellipses of the circles themselves, projected, as every image shows them, with errors of their shapes."""
    rays = network.rays
    centres, axes, angles = [], [], []
    for i, p in zip(rays.image, rays.point, strict=True):
        X = (circle(state.points[p], n[p], radius, 90) - state.centre[i]) @ state.R[i]
        centre, size, angle = fitted_ellipse(pinhole(REAL, X))
        centres.append(centre)
        axes.append(size + sigma * rng.normal(size=2))
        a, b = size
        angles.append(angle + np.sqrt(2) * sigma * a / (a**2 - b**2) * rng.normal())
    return np.array(centres), np.array(axes), np.array(angles)


def test_normals_come_out_of_the_ellipses_of_several_images_as_well_as_they_say():
    rng = np.random.default_rng(5)
    network, state, n, radius = network_of(rng, 6, 60)
    _, axes, angles = ellipses(network, state, n, radius, rng, 0.02)
    rays = network.rays
    found = facing(network, state, rays.image, rays.point, axes, angles, np.full(rays.count, 0.02))
    good = np.isfinite(found.sigma_rad)
    assert good.mean() > 0.9
    error = np.linalg.norm(found.normal - n, axis=1)[good]
    # two directions of which sigma is the larger
    assert 0.9 < np.sqrt(np.mean((error / found.sigma_rad[good]) ** 2)) < 1.45
    assert error.max() < 0.01
    np.testing.assert_allclose(found.radius_m[good], radius, rtol=0.01)


def test_one_image_leaves_two_normals_and_so_none():
    rng = np.random.default_rng(6)
    network, state, n, radius = network_of(rng, 1, 10)
    _, axes, angles = ellipses(network, state, n, radius, rng, 0.02)
    rays = network.rays
    found = facing(network, state, rays.image, rays.point, axes, angles, np.full(rays.count, 0.02))
    assert np.isnan(found.normal).all()


def test_with_normals_found_the_centres_of_ellipses_become_those_of_circles():
    rng = np.random.default_rng(7)
    network, state, n, radius = network_of(rng, 5, 12)
    centres, axes, angles = ellipses(network, state, n, radius, rng, 0.02)
    rays = network.rays
    found = facing(network, state, rays.image, rays.point, axes, angles, np.full(rays.count, 0.02))
    off = network_eccentricity(network, state, rays.image, rays.point, found.normal, np.full(12, radius))
    known = np.isfinite(off).all(1)
    X = np.einsum("nji,nj->ni", state.R[rays.image], state.points[rays.point] - state.centre[rays.image])
    truth = pinhole(REAL, X)
    before, after = (np.abs(v - truth)[known].max() for v in (centres, centres - off))
    assert before > 0.01
    assert after < 0.25 * before
