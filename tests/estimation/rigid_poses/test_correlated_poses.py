"""Poses of bodies whose points have errors in common: uncertainty against draws, and independence of the datum."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from truing.estimation.covariance import relative, relative_of_pair, survey_frame_covariance
from truing.estimation.rigid_poses.correlated_poses import JointMotions, PointsOfBodies, joint_motions, survey_part
from truing.estimation.rotation import exp_so3, log_so3, skew

Array = NDArray[np.float64]

_RNG = np.random.default_rng(5)
_BODY = np.repeat([0, 1], [9, 8])
_SOURCE = np.concatenate([_RNG.uniform(-0.5, 0.5, (9, 3)), _RNG.uniform(-0.3, 0.3, (8, 3))])
_R = exp_so3(np.array([[0.2, -0.1, 0.4], [0.5, 0.3, -0.2]]))
_T = np.array([[0.1, 0.2, 2.0], [0.3, -0.4, 2.9]])
_PLACE = np.einsum("nij,nj->ni", _R[_BODY], _SOURCE) + _T[_BODY]
_NOTHING = np.zeros((len(_SOURCE), 3, 3))


def _covariance() -> Array:
    """Points that bend and stretch together, ten times what each errs alone."""
    x = _PLACE - _PLACE.mean(0)
    fields = [np.outer(x[:, i], np.eye(3)[j]).ravel() for i in range(3) for j in range(3)]
    fields += [np.outer(x[:, i] * x[:, j], np.eye(3)[k]).ravel() for i in range(3) for j in range(3) for k in range(3)]
    common = np.array(fields).T * 2e-5
    return common @ common.T + 4e-12 * np.eye(3 * len(x))


def _fit(target: Array, cov: Array) -> JointMotions:
    return joint_motions(PointsOfBodies(_SOURCE, target, _BODY, _NOTHING, cov), _R.copy(), _T.copy())


def _error(found: tuple[Array, Array, Array]) -> Array:
    R, p, _ = found
    R0, p0, _ = relative(_R[0], _T[0], np.zeros((6, 6)), _R[1], _T[1], np.zeros((6, 6)))
    return np.concatenate([p - p0, log_so3(R @ R0.T)])


def _pulls(stated_of_all: bool) -> float:
    cov, rng = _covariance(), np.random.default_rng(11)
    blocks = np.kron(np.eye(len(_SOURCE)), np.ones((3, 3)))
    believed = cov if stated_of_all else cov * blocks
    root = np.linalg.cholesky(cov)
    total = []
    for _ in range(150):
        motions = _fit(_PLACE + (root @ rng.normal(size=len(cov))).reshape(-1, 3), believed)
        found = relative_of_pair(motions.R[0], motions.t[0], motions.R[1], motions.t[1], motions.covariance(believed))
        error = _error(found)
        total.append(error @ np.linalg.solve(found[2], error))
    return float(np.mean(total) / 6)


def test_the_uncertainty_of_relative_poses_is_true_with_correlations_and_not_without() -> None:
    """The mean of 150 chi-squares with 6 degrees is one within 0.05: four of that."""
    assert _pulls(True) == pytest.approx(1.0, abs=0.2)
    assert not 0.5 < _pulls(False) < 2.0


def _datum(held: Array) -> Array:
    """From any datum into one by conditions held (3N, 6) on the points: Baarda's transformation."""
    G = np.concatenate([np.tile(np.eye(3), (len(_PLACE), 1)), -skew(_PLACE).reshape(-1, 3)], axis=1)
    return np.eye(len(G)) - G @ np.linalg.solve(held.T @ G, held.T)


def test_relative_poses_do_not_depend_on_the_datum_of_the_network() -> None:
    cov = _covariance()
    G = np.concatenate([np.tile(np.eye(3), (len(_PLACE), 1)), -skew(_PLACE).reshape(-1, 3)], axis=1)
    minimal = np.zeros((len(cov), 6))
    minimal[[0, 1, 2, 24, 25, 46], range(6)] = 1.0
    error = np.linalg.cholesky(cov) @ np.random.default_rng(2).normal(size=len(cov))
    found = []
    for held in (G, minimal):
        S = _datum(held)
        motions = _fit(_PLACE + (S @ error).reshape(-1, 3), S @ cov @ S.T)
        found.append(
            relative_of_pair(motions.R[0], motions.t[0], motions.R[1], motions.t[1], motions.covariance(S @ cov @ S.T))
        )
    sigma = np.sqrt(np.diagonal(found[0][2]))
    assert np.all(np.abs(_error(found[0]) - _error(found[1])) < 1e-3 * sigma)
    np.testing.assert_allclose(found[1][2], found[0][2], atol=1e-5 * sigma.max() ** 2)


def test_the_body_of_the_datum_has_zero_variance() -> None:
    """The only body of a network in inner constraints: what is left of its motion is rounding."""
    own = _BODY == 0
    x = _PLACE[own]
    G = np.concatenate([np.tile(np.eye(3), (len(x), 1)), -skew(x).reshape(-1, 3)], axis=1)
    S = np.eye(len(G)) - G @ np.linalg.solve(G.T @ G, G.T)
    cov = S @ _covariance()[: len(G), : len(G)] @ S.T
    points = PointsOfBodies(_SOURCE[own], x, np.zeros(own.sum(), int), _NOTHING[own], cov)
    found = joint_motions(points, _R[:1], _T[:1]).covariance(cov)
    assert np.linalg.eigvalsh(found).min() > -1e-30
    assert (np.diagonal(found) >= 0.0).all()
    assert np.diagonal(found).max() < 1e-10 * np.diagonal(cov).max()


def test_independent_points_give_what_each_body_gives_by_itself() -> None:
    rng = np.random.default_rng(3)
    cov = np.eye(3 * len(_SOURCE)) * 1e-10
    target = _PLACE + 1e-5 * rng.normal(size=_PLACE.shape)
    together = _fit(target, cov)
    for number in (0, 1):
        own = number == _BODY
        alone = PointsOfBodies(
            _SOURCE[own], target[own], np.zeros(own.sum(), int), _NOTHING[own], cov[: 3 * own.sum(), : 3 * own.sum()]
        )
        single = joint_motions(alone, _R[number][None], _T[number][None])
        np.testing.assert_allclose(together.t[number], single.t[0], atol=1e-12)
        np.testing.assert_allclose(together.R[number], single.R[0], atol=1e-12)


def test_a_gross_error_shows_in_its_own_point_although_all_bend_together() -> None:
    """A shift that disappears in what points err together is beyond what one in ten thousand reaches by chance."""
    target = _PLACE.copy()
    target[4] += [3e-5, 0.0, 0.0]
    tests = _fit(target, _covariance()).tests
    assert int(np.argmax(tests)) == 4
    assert tests[4] > 21.1
    assert 3.0 * np.sqrt(_covariance()[12, 12]) > 3e-5


def test_errors_of_the_survey_are_those_of_fits_body_by_body() -> None:
    rng = np.random.default_rng(4)
    survey = rng.normal(size=(len(_SOURCE), 3, 3)) * 1e-5
    survey = survey @ np.swapaxes(survey, 1, 2)
    noise = np.eye(3) * 1e-10
    frame = np.ones(len(_SOURCE), bool)
    frame[[3, 12]] = False
    points = PointsOfBodies(_SOURCE, _PLACE, _BODY, survey, np.kron(np.eye(len(_SOURCE)), noise))
    motions = joint_motions(points, _R.copy(), _T.copy())
    part = survey_part(_SOURCE, survey, _BODY, frame, motions.gain, motions.R)
    both = part + motions.covariance(points.cov_target)
    for number in (0, 1):
        own = number == _BODY
        turned = _R[number] @ survey[own] @ _R[number].T + noise
        alone = survey_frame_covariance(
            _R[number][None],
            _SOURCE[own],
            np.linalg.inv(turned)[None],
            survey[own],
            noise[None, None],
            frame[own],
            np.ones(1, bool),
        )[0]
        here = slice(6 * number, 6 * number + 6)
        np.testing.assert_allclose(both[here, here], alone, atol=1e-9 * np.abs(alone).max())
