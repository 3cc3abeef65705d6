"""The compiled closed-form motion agrees with the plain one for any points."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from tests.estimation.scatter import body, move, random_motions
from tests.tolerance import assert_close
from truing.estimation.rigid_poses import batched_kernel
from truing.estimation.rigid_poses import umeyama as umeyama_module
from truing.estimation.rigid_poses.rigid import RigidFit
from truing.estimation.rigid_poses.umeyama import umeyama

SIGMA = 5e-6
NUMBERS = ("R", "t", "scale", "covariance", "scale_sigma", "rms")


def assert_same(fast: RigidFit, plain: RigidFit, relative: float = 1e-12) -> None:
    """Fail unless two fits agree: statuses and counts exactly, numbers to rounding."""
    assert list(fast.status) == list(plain.status)
    assert np.array_equal(fast.n_used, plain.n_used)
    for name in NUMBERS:
        numbers, expected = getattr(fast, name), getattr(plain, name)
        assert np.array_equal(np.isnan(numbers), np.isnan(expected)), name
        size = max(np.nanmax(np.abs(expected), initial=0.0), 1e-300)
        assert_close(np.nan_to_num(numbers), np.nan_to_num(expected), atol=relative * size, what=name)


def pairs(rng, poses=100, points=9, noise=1e-3, shape=(1.0, 1.0, 1.0)):
    x = body(rng, points) * shape
    R, t = random_motions(rng, poses)
    return x, move(R, t, x) + noise * rng.normal(size=(poses, points, 3))


def sigmas(rng, poses, points):
    return [None, SIGMA, np.full((poses, 1), SIGMA), SIGMA * rng.uniform(0.5, 2.0, (poses, points))]


@pytest.mark.parametrize("points", [3, 4, 9, 20, 101])
@pytest.mark.parametrize("form", range(4))
def test_equals_the_plain_form_for_every_form_of_noise(points, form):
    rng = np.random.default_rng(points)
    x, y = pairs(rng, points=points)
    w = rng.uniform(0.2, 3.0, (100, points))
    sigma = sigmas(rng, 100, points)[form]
    # three random points can be nearly in line, which costs digits in either form
    assert_same(batched_kernel.solve(x, y, w, sigma=sigma), umeyama(x, y, w, sigma=sigma), 1e-11)


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-2, 0.3, 10.0])
def test_equals_the_plain_form_however_poor_the_fit(noise):
    x, y = pairs(np.random.default_rng(1), poses=2000, noise=noise)
    fast, plain = batched_kernel.solve(x, y), umeyama(x, y)
    U, s, Vt = np.linalg.svd(np.einsum("bni,nj->bij", y - y.mean(1, keepdims=True), x - x.mean(0)))
    gap = s[:, 1] + np.linalg.det(U @ Vt) * s[:, 2]
    # rounding counts by how much worse the next best attitude is
    assert (np.abs(fast.R - plain.R).max((1, 2)) <= 2e-14 * s[:, 0] / gap).all()
    assert_close(fast.rms, plain.rms, atol=1e-14 * max(noise, 1.0))
    assert_close(np.linalg.det(fast.R), np.ones(2000), atol=1e-13)
    assert_close(fast.R @ np.swapaxes(fast.R, 1, 2), np.broadcast_to(np.eye(3), (2000, 3, 3)), atol=1e-14)


@pytest.mark.parametrize(
    "shape",
    [(1.0, 1.0, 0.0), (1.0, 1.0, 1e-7), (1.0, 1e-2, 1e-2), (1.0, 1e-5, 1e-5), (1e-9, 1e-9, 1e-9), (1e6, 1e6, 1e6)],
)
def test_equals_the_plain_form_for_flat_thin_and_oddly_sized_bodies(shape):
    rng = np.random.default_rng(2)
    x, y = pairs(rng, noise=1e-7 * max(shape), shape=shape)
    fast, plain = batched_kernel.solve(x, y, sigma=SIGMA), umeyama(x, y, sigma=SIGMA)
    assert list(fast.status) == list(plain.status)
    assert_close(fast.apply(x), plain.apply(x), atol=1e-13 * (1.0 + max(shape)))
    spread = np.sort(np.asarray(shape))[1] / max(shape)
    assert_close(fast.R, plain.R, atol=1e-13 / spread**2)


def test_mirror_images_and_half_turns_never_give_a_reflection():
    rng = np.random.default_rng(3)
    x = body(rng, 8)
    targets = np.stack([x * sign for sign in ([1, 1, -1], [-1, -1, -1], [1, -1, -1], [-1, -1, 1], [1, 1, 1])])
    fast = batched_kernel.solve(x, targets)
    assert_same(fast, umeyama(x, targets))
    assert_close(np.linalg.det(fast.R), np.ones(5), atol=1e-12)
    octahedron = np.vstack([np.eye(3), -np.eye(3)])
    assert_same(batched_kernel.solve(octahedron, -octahedron), umeyama(octahedron[None], -octahedron))


def test_missing_points_may_be_nan_and_used_ones_may_not():
    rng = np.random.default_rng(4)
    x, y = pairs(rng)
    w = rng.uniform(0.5, 2.0, y.shape[:2]) * (rng.random(y.shape[:2]) < 0.6)
    y[w == 0] = np.nan
    assert_same(batched_kernel.solve(x, y, w, sigma=SIGMA), umeyama(x, y, w, sigma=SIGMA), 1e-10)
    y[70, 3], w[70, 3] = np.inf, 1.0
    with pytest.raises(ValueError, match="target: found a non-finite point"):
        batched_kernel.solve(x, y, w)


def test_degenerate_entries_have_the_status_of_the_plain_form_and_spoil_no_neighbour():
    rng = np.random.default_rng(5)
    x, y = pairs(rng, poses=60)
    x = np.repeat(x[None], 60, axis=0)
    w = np.ones(x.shape[:2])
    w[7, 2:] = 0.0
    x[15] = x[15, :1]
    x[16] = np.linspace(-0.2, 0.2, 9)[:, None] * np.array([0.3, -0.5, 0.7])
    y[33] = y[33, 4]
    w[59] = 0.0
    fast = batched_kernel.solve(x, y, w, sigma=SIGMA)
    assert_same(fast, umeyama(x, y, w, sigma=SIGMA))
    assert [str(s) for s in fast.status[[7, 15, 16, 33, 59]]] == [
        "too-few-points", "coincident", "collinear", "coincident", "too-few-points",
    ]  # fmt: skip
    assert np.count_nonzero(fast.ok) == 55


def test_one_survey_one_measurement_or_one_set_of_weights_may_serve_the_whole_batch():
    rng = np.random.default_rng(6)
    x, y = pairs(rng, poses=50)
    w = rng.uniform(0.5, 2.0, (50, 9))
    for source, target, weight in ((x, y, w), (x[None], y, w[0]), (x, y[0], w), (y, x, None), (x[None], y[0], None)):
        assert_same(batched_kernel.solve(source, target, weight), umeyama(source, target, weight))


def test_the_number_of_threads_changes_nothing():
    rng = np.random.default_rng(7)
    x, y = pairs(rng, poses=5003)
    one, two = (batched_kernel.solve(x, y, sigma=SIGMA, threads=k) for k in (1, 2))
    for name in NUMBERS:
        assert np.array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize(
    ("source", "target", "weight", "message"),
    [
        (np.zeros((4, 2)), np.zeros((4, 3)), None, r"source: found shape \(4, 2\)"),
        (np.zeros((4, 3)), np.zeros((7, 5, 3)), None, "found 4 source and 5 target points"),
        (np.eye(4, 3), np.eye(4, 3), [-1, 1, 1, 1], "negative"),
        (np.eye(4, 3), np.eye(4, 3), [np.nan, 1, 1, 1], "negative"),
        (np.zeros((2, 4, 3)), np.zeros((3, 4, 3)), None, "shape mismatch"),
        (np.zeros((2, 4, 3)), np.zeros((2, 4, 3)), np.ones(3), "broadcast"),
    ],
)
def test_broken_input_is_refused_by_name(source, target, weight, message):
    with pytest.raises(ValueError, match=message):
        batched_kernel.solve(source, target, weight)


def test_large_batches_run_compiled_with_equal_results(monkeypatch):
    rng = np.random.default_rng(8)
    x, y = pairs(rng, poses=500)
    w = rng.uniform(0.5, 2.0, (500, 9))
    plain = umeyama(x, y, w, sigma=SIGMA)
    monkeypatch.setattr(umeyama_module, "_WORTH_COMPILED_CODE", 4500)
    # stands in for the plain form, which a large batch must not reach
    monkeypatch.setattr(umeyama_module, "solve_weighted", None)
    assert_same(umeyama(x, y, w, sigma=SIGMA), plain)


def test_an_empty_batch_is_no_fault():
    assert len(batched_kernel.solve(np.zeros((0, 4, 3)), np.zeros((0, 4, 3))).R) == 0


def test_imports_where_compiled_code_cannot_be_kept():
    code = (
        "import numba.core.caching as c; getattr(c, 'CacheImpl', getattr(c, '_CacheImpl', 0))._locator_classes = [];"
        "import truing.estimation.rigid_poses.batched_kernel as k; print(callable(k.solve_range))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "True", done.stderr


def test_importing_the_package_and_the_plain_form_does_not_import_numba():
    rooms = "truing.estimation.rigid_poses.umeyama, truing.estimation.rigid_poses.robust"
    code = f"import sys, truing, {rooms}; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "False", done.stderr
