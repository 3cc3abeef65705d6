"""Linear response to a drive: linear (diagonal) and matrix models, for any instrument, with tests.

Tests cover the significance of entries, the choice between models, and the shape of the matrix.

For the telescope the response is the shift of the six attachments along z and the drive the six actuators. For the
force sensor the response is the displacement of the platform and the drive the wrench on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.quality import holm_adjusted

Form = Literal["none", "linear", "matrix"]
_NORMAL_MEDIAN = 0.6745  # median of |z| of a standard normal
_RANK_CUTOFF = 1e-10  # relative eigenvalue below which a direction carries no information
FALSE_ALARM = 0.05  # family-wise, over all entries of one table
_SPANNED = 1e-9  # relative to the largest drive: rounding of a combination
_EXACT = 1e-6  # residuals in declared standard deviations, smaller than in any measurement


@dataclass(frozen=True)
class ResponseFit:
    """Generalised least-squares fit of ``y = offset + K u``.

    coefficients (L, D): K, zero off the diagonal for ``linear``. covariance (P, P): of the free entries of K in
    row-major order, offsets marginalised. free (L, D): fitted entries of K. offset (G, L): one per group. residuals (N,
    L): y - fitted, NaN if y is missing. loo_residuals (N, L): each observation minus its prediction from all others
    (exact). chi_square, dof: of the residuals under the stated covariance. deficient: number of undetermined directions
    of the parameters (with the shortest solution). offset_covariance (L, D + 1): of the first group's offset with the
    entries of its row of K, and with itself.
    """

    form: Form
    coefficients: Array
    covariance: Array
    free: Mask
    offset: Array
    residuals: Array
    loo_residuals: Array
    chi_square: float
    dof: int
    deficient: int
    offset_covariance: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation (L, D) of each entry of K; zero for entries outside the model."""
        sigma = np.zeros(self.free.shape)
        sigma[self.free] = np.sqrt(np.diag(self.covariance))
        return sigma

    def predict(self, u: Array) -> Array:
        """Return the response (N, L) to drives (N, D), without offset."""
        return u @ self.coefficients.T

    def predicted_variance(self, u: Array) -> Array:
        """Return the variance (N, L) of offset + K u of the first group."""
        rows, columns = np.nonzero(self.free)
        variance = 2.0 * u @ self.offset_covariance[:, :-1].T + self.offset_covariance[:, -1]
        for k in range(len(self.free)):
            mask = rows == k
            drive = u[:, columns[mask]]
            variance[:, k] += np.einsum("np,pq,nq->n", drive, self.covariance[np.ix_(mask, mask)], drive)
        return np.maximum(variance, 0.0)


def fit_response(
    u: Array,
    y: Array,
    cov: Array,
    *,
    form: Form = "matrix",
    offset_cov: Array | None = None,
    group: Index | None = None,
) -> ResponseFit:
    """Return the fit of ``y_n = c_g(n) + K u_n`` by generalised least squares (telescope report eq. 1-3; force sensor
    eq. 28).

    u (N, D): drives; y (N, L): responses, NaN if missing; cov (N, L, L): covariance of each y, singular if a frame was
    fitted to the same data; offset_cov (L, L): prior covariance of the offset (an error common to all rows, such as the
    survey's), None for a free offset; group (N,): offset of each row, by default one for all. Raises ValueError for
    shapes that do not agree, and for ``linear`` with D != L.
    """
    u, y, cov = np.asarray(u, float), np.asarray(y, float), np.asarray(cov, float)
    (n, d), width = u.shape, y.shape[1]
    if y.shape[0] != n or cov.shape != (n, width, width):
        raise ValueError(f"found u {u.shape}, y {y.shape} and cov {cov.shape}, expected (N, D), (N, L) and (N, L, L)")
    if form == "linear" and d != width:
        raise ValueError(f"linear model: found {width} responses and {d} drives, expected as many drives as responses")
    group = np.zeros(n, np.int64) if group is None else np.asarray(group)
    if width > 1 and _separate(cov, np.isfinite(y), offset_cov):
        return _component_by_component(u, y, cov, form, offset_cov, group)
    free = {
        "none": np.zeros((width, d), bool),
        "linear": np.eye(width, d, dtype=bool),
        "matrix": np.ones((width, d), bool),
    }[form]
    weight = _precision(cov, np.isfinite(y))
    design = _design(u, free, group)
    prior = _offset_precision(offset_cov, int(free.sum()), width, int(group.max()) + 1)
    return _solve(form, free, _WeightedProblem(design, np.nan_to_num(y), np.isfinite(y), weight, prior))


def _separate(cov: Array, is_observed: Mask, offset_cov: Array | None) -> bool:
    """True if components have independent errors, so that each can be fitted separately."""
    is_cross = ~np.eye(cov.shape[1], dtype=bool)
    both = is_observed[:, :, None] & is_observed[:, None, :] & is_cross
    return not np.any(cov[both]) and (offset_cov is None or not np.any(offset_cov[is_cross]))


def _component_by_component(
    u: Array, y: Array, cov: Array, form: Form, offset_cov: Array | None, group: Index
) -> ResponseFit:
    """Return the same fit for uncoupled components, each from the rows in which it was observed."""
    (n, width), groups = y.shape, int(group.max()) + 1
    drives = [np.arange(u.shape[1]) if form == "matrix" else np.arange(k, k + (form == "linear")) for k in range(width)]
    ends = np.cumsum([len(drives_of_component) for drives_of_component in drives])
    covariance = np.zeros((ends[-1], ends[-1]))
    coefficients, offset = np.zeros((width, u.shape[1])), np.zeros((groups, width))
    residuals, loo = np.full((2, n, width), np.nan)
    free, deficient, chi_square, dof = np.zeros(coefficients.shape, bool), 0, 0.0, 0
    with_offset = np.zeros((width, u.shape[1] + 1))
    for k, drive in enumerate(drives):
        free[k, drive] = True
        rows = np.flatnonzero(np.isfinite(y[:, k]))
        if not len(rows):
            deficient += len(drive) + (groups if offset_cov is None else 0)
            continue
        met, index = np.unique(group[rows], return_inverse=True)
        prior = None if offset_cov is None else offset_cov[k : k + 1, k : k + 1]
        weight = _precision(cov[rows, k, k][:, None, None], np.ones((len(rows), 1), bool))
        every = np.ones((1, len(drive)), bool)
        design = _design(u[np.ix_(rows, drive)], every, index)
        precision = _offset_precision(prior, len(drive), 1, len(met))
        observed = np.ones((len(rows), 1), bool)
        fit = _solve("matrix", every, _WeightedProblem(design, y[rows, k, None], observed, weight, precision))
        coefficients[k, drive], offset[met, k] = fit.coefficients[0], fit.offset[:, 0]
        with_offset[k, [*drive, -1]] = fit.offset_covariance[0]
        residuals[rows, k], loo[rows, k] = fit.residuals[:, 0], fit.loo_residuals[:, 0]
        covariance[ends[k] - len(drive) : ends[k], ends[k] - len(drive) : ends[k]] = fit.covariance
        deficient += fit.deficient + (groups - len(met) if offset_cov is None else 0)
        chi_square, dof = chi_square + fit.chi_square, dof + fit.dof
    return ResponseFit(
        form, coefficients, covariance, free, offset, residuals, loo, chi_square, dof, deficient, with_offset
    )


def _design(u: Array, free: Mask, group: Index) -> Array:
    """Return the derivative (N, L, P) of the response by the free entries of K and the offsets."""
    n, width = len(u), free.shape[0]
    rows, columns = np.nonzero(free)
    groups = int(group.max()) + 1
    design = np.zeros((n, width, len(rows) + groups * width))
    design[:, rows, np.arange(len(rows))] = u[:, columns]
    for leg in range(width):
        design[np.arange(n), leg, len(rows) + group * width + leg] = 1.0
    return design


def _precision(cov: Array, is_observed: Mask) -> Array:
    """Return the pseudo-inverse (N, L, L) of the covariance of observed values; zero for others."""
    masked = np.where(
        is_observed[:, :, None] & is_observed[:, None, :], cov, 0.0
    )  # the covariance of missing values may be infinite
    # Single numbers need no decomposition: this function is called in thirty reweightings of every component.
    if masked.shape[1] == 1:
        return np.divide(1.0, masked, out=np.zeros_like(masked), where=masked > 0.0)
    values, vectors = np.linalg.eigh(masked)
    mask = values > _RANK_CUTOFF * values[:, -1:]
    inverse = np.where(mask, 1.0 / np.where(mask, values, 1.0), 0.0)
    return np.einsum("nik,nk,njk->nij", vectors, inverse, vectors)


def _rank(weight: Array) -> int:
    """Return the number of values that the weights (N, L, L) determine."""
    if weight.shape[1] == 1:
        return int(np.count_nonzero(weight))
    return round(float(np.einsum("nij,nij->", weight, np.linalg.pinv(weight, hermitian=True))))


def _offset_precision(offset_cov: Array | None, n_free: int, width: int, groups: int) -> Array:
    precision = np.zeros((n_free + groups * width,) * 2)
    if offset_cov is not None:
        block = np.linalg.pinv(offset_cov, rcond=_RANK_CUTOFF, hermitian=True)
        for g in range(groups):
            part = slice(n_free + g * width, n_free + (g + 1) * width)
            precision[part, part] = block
    return precision


@dataclass(frozen=True)
class _WeightedProblem:
    """Design (N, L, P), responses (N, L) with their mask, weight matrices (N, L, L), and prior information (P, P)."""

    design: Array
    y: Array
    is_observed: Mask
    weight: Array
    prior: Array


def _solve(form: Form, free: Mask, problem: _WeightedProblem) -> ResponseFit:
    """Return the weighted least-squares fit; ``free`` (L, D) marks the free coefficients."""
    design, y, weight, prior = problem.design, problem.y, problem.weight, problem.prior
    weighted = (weight.transpose(0, 2, 1) @ design).reshape(-1, design.shape[-1])  # matrix products for BLAS: (N M, P)
    normal = weighted.T @ design.reshape(weighted.shape) + prior
    covariance, deficient = _scaled_inverse(normal, np.sqrt((design**2).sum(axis=(0, 1))))
    theta = covariance @ (weighted.T @ y.ravel())
    residuals = y - design @ theta
    loo = _leave_one_out(design, covariance, weight, residuals)
    n_free, width = int(free.sum()), free.shape[0]
    coefficients = np.zeros(free.shape)
    coefficients[free] = theta[:n_free]
    at = n_free + np.arange(width)  # of the first group
    with_offset = np.zeros((width, free.shape[1] + 1))
    with_offset[:, :-1][free] = covariance[at[np.nonzero(free)[0]], np.arange(n_free)]
    with_offset[:, -1] = np.diag(covariance)[at]
    # Rounding may turn the sum of squares of zero residuals negative.
    chi_square = max(float(np.einsum("nl,nlm,nm->", residuals, weight, residuals) + theta @ prior @ theta), 0.0)
    informative = _rank(weight)
    informative += int(np.linalg.matrix_rank(prior, hermitian=True)) if prior.any() else 0
    return ResponseFit(
        form=form,
        coefficients=coefficients,
        covariance=covariance[:n_free, :n_free],
        free=free,
        offset=theta[n_free:].reshape(-1, width),
        residuals=np.where(problem.is_observed, residuals, np.nan),
        loo_residuals=np.where(problem.is_observed, loo, np.nan),
        chi_square=chi_square,
        dof=informative - (len(theta) - deficient),
        deficient=deficient,
        offset_covariance=with_offset,
    )


def _scaled_inverse(normal: Array, size: Array) -> tuple[Array, int]:
    """Return the pseudo-inverse and the number of undetermined directions of the parameters. Scaled to unit diagonal
    first, since drives may differ in unit by many powers of ten. In undetermined directions the shortest solution is
    taken, with lengths measured by the size (P,) of each parameter's effect on a unit response."""
    scale = np.sqrt(np.where(np.diag(normal) > 0.0, np.diag(normal), 1.0))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    mask = values > _RANK_CUTOFF * max(values[-1], 1e-300)
    inverse = (vectors[:, mask] / values[mask]) @ vectors[:, mask].T / np.outer(scale, scale)
    if mask.all():
        return inverse, 0
    size = np.where(size > 0.0, size, 1.0)  # a drive that never moved has no effect to scale by
    open_directions = vectors[:, ~mask] * (size / scale)[:, None]
    basis = np.linalg.qr(open_directions)[0]
    shortest = np.eye(len(size)) - (basis / size[:, None]) @ (basis * size[:, None]).T
    shortest[np.diag(normal) == 0.0] = 0.0  # exactly zero for parameters without data, instead of a ratio of roundings
    return shortest @ inverse @ shortest.T, int((~mask).sum())


def _leave_one_out(design: Array, covariance: Array, weight: Array, residuals: Array) -> Array:
    """Return the residuals of each row against the fit to all others: (I - H_nn)^-1 r_n with blocks of the hat
    matrix."""
    redundancy = np.eye(design.shape[1]) - design @ covariance @ design.transpose(0, 2, 1) @ weight
    if redundancy.shape[1] == 1:
        return np.divide(residuals, redundancy[:, 0], out=np.zeros_like(residuals), where=redundancy[:, 0] != 0.0)
    return np.einsum("nlk,nk->nl", np.linalg.pinv(redundancy, rcond=1e-9), residuals)


def consistent_responses(
    u: Array,
    y: Array,
    cov: Array,
    *,
    offset_cov: Array | None = None,
    fitted: Mask | None = None,
    false_rejections: float = 0.05,
) -> Mask:
    """Return the mask (N, L) of responses that agree with the matrix model, without gross errors.

    Iterates from a robust start to a fixpoint. ``false_rejections``: expected number of good values rejected in the
    whole table. The robust start minimises absolute deviations by reweighting; its median residual widens the limit if
    the noise is larger than declared. The criterion is the predictive residual of each value in units of its standard
    deviation; rows outside ``fitted`` (N,) are predicted by a fit without them.
    """
    from scipy.special import ndtri

    is_observed = np.isfinite(y)
    limit = -ndtri(0.5 * min(1.0, false_rejections / max(is_observed.sum(), 1)))
    basis = is_observed if fitted is None else is_observed & fitted[:, None]
    start = _standardised_l1(u, np.where(basis, y, np.nan), y, cov, offset_cov)
    limit *= max(1.0, float(np.median(start[basis])) / _NORMAL_MEDIAN) if basis.any() else 1.0
    mask = is_observed & (start < 1.5 * limit)
    for _ in range(20):
        fit = fit_response(u, np.where(mask & basis, y, np.nan), cov, offset_cov=offset_cov)
        again = is_observed & (_standardised(fit, u, y, cov) < limit)
        if (again == mask).all():
            break
        mask = again
    return mask


def _standardised(fit: ResponseFit, u: Array, y: Array, cov: Array) -> Array:
    """Return |residual| (N, L) in units of its standard deviation, for rejected and kept values. For a value outside
    the fit, the unit includes the error of K, and is infinite along drives that were never varied."""
    fitted, variance = np.isfinite(fit.residuals), np.einsum("nll->nl", cov)
    residual = fit.residuals
    if not fitted.all():
        residual = np.where(fitted, residual, y - fit.offset[0] - fit.predict(u))
        unseen = np.where(_spanned(u, fitted), fit.predicted_variance(u), np.inf)
        variance = variance + np.where(fitted, 0.0, unseen)
    spread = np.sqrt(variance)
    return np.abs(np.nan_to_num(residual)) / np.where(spread > 0.0, spread, np.inf)


def _spanned(u: Array, fitted: Mask) -> Mask:
    """Return the mask (N, L) of drives (N, D) that are combinations of those in the fit of each response."""
    spanned = np.zeros(fitted.shape, bool)
    for k, rows in enumerate(fitted.T):
        _, size, along = np.linalg.svd(u[rows], full_matrices=False)
        basis = along[size > _SPANNED * size.max(initial=0.0)]
        remainder = u - u @ basis.T @ basis
        spanned[:, k] = np.abs(remainder).max(axis=1, initial=0.0) <= _SPANNED * np.abs(u).max(initial=0.0)
    return spanned


def _standardised_l1(u: Array, rows_used: Array, y: Array, cov: Array, offset_cov: Array | None) -> Array:
    """Return |residual| (N, L) of all y in units of its standard deviation, after a least-absolute-deviation fit to the
    kept ones."""
    root = np.ones(y.shape)
    for _ in range(30):
        fit = fit_response(u, rows_used, cov * root[:, :, None] * root[:, None, :], offset_cov=offset_cov)
        z = _standardised(fit, u, y, cov)
        before, root = root, np.sqrt(np.maximum(z, 1.0))
        if np.array_equal(root, before):  # the next fit is the same
            break
    return z


def residual_sets(fit: ResponseFit) -> dict[str, Array]:
    """Return the residuals of the fit, and those of each row from a fit to all others."""
    return {"": fit.residuals, "cv_": fit.loo_residuals}


def fit_models(u: Array, y: Array, cov: Array, forms: tuple[str, ...], **prior: Any) -> dict[str, ResponseFit]:
    """Return the fits of all model forms to the same data."""
    return {form: fit_response(u, y, cov, form=form, **prior) for form in forms}  # type: ignore[arg-type]


def entry_p_values(fit: ResponseFit, widened: float = 1.0) -> Array:
    """Return the two-sided p-value (L, D) of each entry of K being zero; NaN if not in the model or not determined.

    ``widened``: factor on the standard deviations, for noise larger than declared.
    """
    from scipy.special import ndtr

    p = np.full(fit.free.shape, np.nan)
    sigma = np.sqrt(np.diag(fit.covariance)) * widened
    z = np.divide(fit.coefficients[fit.free], sigma, out=np.full(len(sigma), np.nan), where=sigma > 0.0)
    p[fit.free] = 2.0 * ndtr(-np.abs(z))
    return p


def holm_significant(p: Array, false_alarm: float) -> Mask:
    """Return the mask of tests that are significant at a family-wise false-alarm rate (Holm 1979); NaN is never
    significant."""
    tested = np.isfinite(p)
    significant = np.zeros(p.shape, bool)
    significant[tested] = holm_adjusted(p[tested]) <= false_alarm
    return significant


def gain_p_value(smaller: ResponseFit, larger: ResponseFit) -> float:
    """Return the p-value of the larger of two nested models against the smaller: F test with estimated noise.

    The noise comes from the larger model's residuals, so an error of 10 % in the declared noise does not matter. If
    these residuals are only rounding, as for points that repeat exactly, the declared noise is used (chi-square).
    """
    from scipy.special import chdtrc, fdtrc

    extra = smaller.dof - larger.dof
    if extra <= 0 or larger.dof <= 0:
        return float("nan")
    if larger.chi_square <= _EXACT**2 * larger.dof:
        return float(chdtrc(extra, max(smaller.chi_square - larger.chi_square, 0.0)))
    ratio = (smaller.chi_square - larger.chi_square) / extra / (larger.chi_square / larger.dof)
    return float(fdtrc(extra, larger.dof, max(ratio, 0.0)))


@dataclass(frozen=True)
class Symmetry:
    """Wald test of K = K transposed: chi-square, degrees of freedom, p-value, and the relative asymmetry."""

    chi_square: float
    dof: int
    p_value: float
    relative: float


def symmetry(fit: ResponseFit) -> Symmetry:
    """Return the test of K being symmetric within its uncertainty; for a full square K."""
    n = fit.free.shape[0]
    upper = np.triu_indices(n, 1)
    contrast = np.zeros((len(upper[0]), n * n))
    contrast[np.arange(len(upper[0])), upper[0] * n + upper[1]] = 1.0
    contrast[np.arange(len(upper[0])), upper[1] * n + upper[0]] = -1.0
    chi_square, p_value = _wald(contrast, fit)
    k = fit.coefficients
    return Symmetry(chi_square, len(contrast), p_value, float(np.linalg.norm(k - k.T) / 2.0 / np.linalg.norm(k)))


def pair_couplings(fit: ResponseFit) -> list[tuple[int, int, float, float]]:
    """Return for every pair of legs (from 0): i, j, coupling sqrt((K_ij^2 + K_ji^2)/2), and the p-value of no
    coupling."""
    n = fit.free.shape[0]
    rows = []
    for i, j in zip(*np.triu_indices(n, 1), strict=True):
        contrast = np.zeros((2, n * n))
        contrast[0, i * n + j] = contrast[1, j * n + i] = 1.0
        strength = float(np.sqrt(0.5 * (fit.coefficients[i, j] ** 2 + fit.coefficients[j, i] ** 2)))
        rows.append((int(i), int(j), strength, _wald(contrast, fit)[1]))
    return rows


def _wald(contrast: Array, fit: ResponseFit) -> tuple[float, float]:
    from scipy.special import chdtrc

    value = contrast @ fit.coefficients.ravel()
    chi_square = float(value @ np.linalg.solve(contrast @ fit.covariance @ contrast.T, value))
    return chi_square, float(chdtrc(len(contrast), chi_square))


def significant_rank(fit: ResponseFit, false_alarm: float) -> int:
    """Return the number of independent shapes in K: the smallest rank that leaves only noise.

    K is whitened by its average row and column covariance; singular values beyond the first r are tested against
    chi-square with (L - r)(D - r) degrees of freedom.
    """
    from scipy.special import chdtrc

    rows, columns = fit.free.shape
    blocks = fit.covariance.reshape(rows, columns, rows, columns)
    row_cov = np.einsum("iaja->ij", blocks) / columns
    column_cov = np.einsum("iajb,ji->ab", blocks, np.linalg.inv(row_cov)) / rows
    white = np.linalg.solve(np.linalg.cholesky(row_cov), fit.coefficients)
    white = np.linalg.solve(np.linalg.cholesky(column_cov), white.T).T
    left = np.append(np.cumsum((np.linalg.svd(white, compute_uv=False) ** 2)[::-1])[::-1], 0.0)
    for r in range(min(rows, columns)):
        if chdtrc((rows - r) * (columns - r), left[r]) > false_alarm:
            return r
    return min(rows, columns)


@dataclass(frozen=True)
class RingShape:
    """Shape of the attachments' shifts around the ring: shares of the mean square, and the principal shape.

    lift, tilt, buckle sum to 1; buckle is the part that no plane explains. principal (L,): unit shape with the largest
    share over poses, principal_share: its share, amplitude: its largest value, in the unit of the shifts.
    """

    lift: float
    tilt: float
    buckle: float
    principal: Array
    principal_share: float
    amplitude: float


def ring_shape(shifts: Array, attachments: Array) -> RingShape:
    """Return shifts (N, L) at attachment points (L, 3) split into lift, tilt of the ring's plane, and buckling."""
    plane = np.column_stack([np.ones(len(attachments)), attachments[:, :2] - attachments[:, :2].mean(axis=0)])
    basis = np.linalg.qr(plane)[0]
    parts = shifts @ basis
    total = float((shifts**2).sum()) or 1.0
    lift, tilt = float((parts[:, 0] ** 2).sum()) / total, float((parts[:, 1:] ** 2).sum()) / total
    left, values, shapes = np.linalg.svd(shifts, full_matrices=False)
    amplitude = float(np.abs(left[:, 0] * values[0]).max())
    share = float(values[0] ** 2 / total)
    return RingShape(lift, tilt, max(0.0, 1.0 - lift - tilt), shapes[0], share, amplitude)


def birge(fit: ResponseFit) -> float:
    """Return the factor on the standard deviations (Birge ratio): above 1 only for residuals larger than the declared
    noise allows."""
    from scipy.special import chdtrc

    if fit.dof <= 0 or chdtrc(fit.dof, fit.chi_square) > 0.01:
        return 1.0
    return float(np.sqrt(fit.chi_square / fit.dof))


def entry_tests(fit: ResponseFit) -> tuple[Array, Array, Mask]:
    """Return sigma, p-value and significance (L, D) of every entry, widened if the noise is larger than declared."""
    factor = birge(fit)
    p = entry_p_values(fit, factor)
    return fit.sigma * factor, p, holm_significant(p, FALSE_ALARM)
