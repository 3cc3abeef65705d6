"""A response that follows a drive: the linear (diagonal) and the matrix model, for any instrument, and what they say.

Which entries are real, which model earns its parameters, and which shape it has.

For the telescope the response is the shift of the six attachments along z and the drive the six actuators; for the
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
_SPANNED = 1e-9  # of the largest drive: what rounding leaves of a combination
_EXACT = 1e-6  # residuals, in declared standard deviations, that no measurement has


@dataclass(frozen=True)
class ResponseFit:
    """Generalised least-squares fit of ``y = offset + K u``.

    coefficients (L, D): K, zero off the diagonal for ``linear``. covariance (P, P): of the free entries of K in
    row-major order, offsets marginalised. free (L, D): which entries of K were fitted. offset (G, L): one per group.
    residuals (N, L): y - fitted, NaN where y was missing. loo_residuals (N, L): each observation predicted from
    all the others (exact). chi_square, dof: of the residuals under the stated covariance. deficient:
    directions of the parameters which the data do not determine (there the shortest solution was taken).
    offset_covariance (L, D + 1): of the first group's offset with the entries of its row of K, and with itself.
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
        """(L, D) standard deviation of each entry of K; zero where the entry is not part of the model."""
        sigma = np.zeros(self.free.shape)
        sigma[self.free] = np.sqrt(np.diag(self.covariance))
        return sigma

    def predict(self, u: Array) -> Array:
        """(N, L) response to drives (N, D), without offset."""
        return u @ self.coefficients.T

    def predicted_variance(self, u: Array) -> Array:
        """(N, L) variance of offset + K u of the first group."""
        rows, columns = np.nonzero(self.free)
        found = 2.0 * u @ self.offset_covariance[:, :-1].T + self.offset_covariance[:, -1]
        for k in range(len(self.free)):
            own = rows == k
            drive = u[:, columns[own]]
            found[:, k] += np.einsum("np,pq,nq->n", drive, self.covariance[np.ix_(own, own)], drive)
        return np.maximum(found, 0.0)


def fit_response(
    u: Array,
    y: Array,
    cov: Array,
    *,
    form: Form = "matrix",
    offset_cov: Array | None = None,
    group: Index | None = None,
) -> ResponseFit:
    """Fit ``y_n = c_g(n) + K u_n`` by generalised least squares (telescope report eq. 1-3; force sensor eq. 28).

    u (N, D) drives; y (N, L) responses, NaN where missing; cov (N, L, L) covariance of each y, singular where a frame
    was fitted to the same data; offset_cov (L, L) the prior covariance of the offset (an error common to all
    rows, such as the survey's), None for a free offset; group (N,) which offset a row carries, by default one
    for all. Raises ValueError for shapes that do not agree, and for ``linear`` with D != L.
    """
    u, y, cov = np.asarray(u, float), np.asarray(y, float), np.asarray(cov, float)
    (n, d), width = u.shape, y.shape[1]
    if y.shape[0] != n or cov.shape != (n, width, width):
        raise ValueError(f"u {u.shape}, y {y.shape} and cov {cov.shape} must be (N, D), (N, L) and (N, L, L)")
    if form == "linear" and d != width:
        raise ValueError(f"the linear model pairs each response with its own drive: {width} responses, {d} drives")
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
    return _solve(form, free, design, np.nan_to_num(y), np.isfinite(y), weight, prior)


def _separate(cov: Array, seen: Mask, offset_cov: Array | None) -> bool:
    """Whether the components have no error in common: each is a problem of its own, and much smaller."""
    apart = ~np.eye(cov.shape[1], dtype=bool)
    both = seen[:, :, None] & seen[:, None, :] & apart
    return not np.any(cov[both]) and (offset_cov is None or not np.any(offset_cov[apart]))


def _component_by_component(
    u: Array, y: Array, cov: Array, form: Form, offset_cov: Array | None, group: Index
) -> ResponseFit:
    """The same fit where nothing couples the components: each from the rows in which it was seen."""
    from scipy.linalg import block_diag

    (n, width), groups = y.shape, int(group.max()) + 1
    drives = [np.arange(u.shape[1]) if form == "matrix" else np.arange(k, k + (form == "linear")) for k in range(width)]
    coefficients, offset = np.zeros((width, u.shape[1])), np.zeros((groups, width))
    residuals, loo = np.full((2, n, width), np.nan)
    free, blocks, deficient, chi_square, dof = np.zeros(coefficients.shape, bool), [], 0, 0.0, 0
    beside = np.zeros((width, u.shape[1] + 1))
    for k, own in enumerate(drives):
        free[k, own] = True
        rows = np.flatnonzero(np.isfinite(y[:, k]))
        if not len(rows):
            blocks.append(np.zeros((len(own), len(own))))
            deficient += len(own) + (groups if offset_cov is None else 0)
            continue
        met, place = np.unique(group[rows], return_inverse=True)
        prior = None if offset_cov is None else offset_cov[k : k + 1, k : k + 1]
        weight = _precision(cov[rows, k, k][:, None, None], np.ones((len(rows), 1), bool))
        every = np.ones((1, len(own)), bool)
        design = _design(u[np.ix_(rows, own)], every, place)
        precision = _offset_precision(prior, len(own), 1, len(met))
        one = _solve("matrix", every, design, y[rows, k, None], np.ones((len(rows), 1), bool), weight, precision)
        coefficients[k, own], offset[met, k] = one.coefficients[0], one.offset[:, 0]
        beside[k, [*own, -1]] = one.offset_covariance[0]
        residuals[rows, k], loo[rows, k] = one.residuals[:, 0], one.loo_residuals[:, 0]
        blocks.append(one.covariance)
        deficient += one.deficient + (groups - len(met) if offset_cov is None else 0)
        chi_square, dof = chi_square + one.chi_square, dof + one.dof
    return ResponseFit(
        form, coefficients, block_diag(*blocks), free, offset, residuals, loo, chi_square, dof, deficient, beside
    )


def _design(u: Array, free: Mask, group: Index) -> Array:
    """(N, L, P) derivative of the response by the free entries of K and the offsets."""
    n, width = len(u), free.shape[0]
    rows, columns = np.nonzero(free)
    groups = int(group.max()) + 1
    design = np.zeros((n, width, len(rows) + groups * width))
    design[:, rows, np.arange(len(rows))] = u[:, columns]
    for leg in range(width):
        design[np.arange(n), leg, len(rows) + group * width + leg] = 1.0
    return design


def _precision(cov: Array, seen: Mask) -> Array:
    """(N, L, L) pseudo-inverse of the covariance of what was seen; zero for what was not."""
    masked = np.where(seen[:, :, None] & seen[:, None, :], cov, 0.0)  # of what was not seen it may be infinite
    if masked.shape[1] == 1:  # thirty reweightings of every target's components: no decomposition of single numbers
        return np.divide(1.0, masked, out=np.zeros_like(masked), where=masked > 0.0)
    values, vectors = np.linalg.eigh(masked)
    kept = values > _RANK_CUTOFF * values[:, -1:]
    inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    return np.einsum("nik,nk,njk->nij", vectors, inverse, vectors)


def _rank(weight: Array) -> int:
    """How many numbers the weights (N, L, L) inform of."""
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


def _solve(form: Form, free: Mask, design: Array, y: Array, seen: Mask, weight: Array, prior: Array) -> ResponseFit:
    weighted = (weight.transpose(0, 2, 1) @ design).reshape(-1, design.shape[-1])  # products that BLAS knows: (N M, P)
    normal = weighted.T @ design.reshape(weighted.shape) + prior
    covariance, deficient = _scaled_inverse(normal, np.sqrt((design**2).sum(axis=(0, 1))))
    theta = covariance @ (weighted.T @ y.ravel())
    residuals = y - design @ theta
    loo = _leave_one_out(design, covariance, weight, residuals)
    n_free, width = int(free.sum()), free.shape[0]
    coefficients = np.zeros(free.shape)
    coefficients[free] = theta[:n_free]
    at = n_free + np.arange(width)  # of the first group
    beside = np.zeros((width, free.shape[1] + 1))
    beside[:, :-1][free] = covariance[at[np.nonzero(free)[0]], np.arange(n_free)]
    beside[:, -1] = np.diag(covariance)[at]
    # Residuals that are nothing but rounding leave a sum of squares that rounding may turn below zero.
    chi_square = max(float(np.einsum("nl,nlm,nm->", residuals, weight, residuals) + theta @ prior @ theta), 0.0)
    informative = _rank(weight)
    informative += int(np.linalg.matrix_rank(prior, hermitian=True)) if prior.any() else 0
    return ResponseFit(
        form=form,
        coefficients=coefficients,
        covariance=covariance[:n_free, :n_free],
        free=free,
        offset=theta[n_free:].reshape(-1, width),
        residuals=np.where(seen, residuals, np.nan),
        loo_residuals=np.where(seen, loo, np.nan),
        chi_square=chi_square,
        dof=informative - (len(theta) - deficient),
        deficient=deficient,
        offset_covariance=beside,
    )


def _scaled_inverse(normal: Array, size: Array) -> tuple[Array, int]:
    """Pseudo-inverse, and how many directions of the parameters the data leave open.

    Scaled to unit diagonal before it is judged (drives may differ in unit by many powers of ten). In the open
    directions the shortest solution is taken, lengths measured by the size (P,) of each parameter's effect on
    a unit response.
    """
    scale = np.sqrt(np.where(np.diag(normal) > 0.0, np.diag(normal), 1.0))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    kept = values > _RANK_CUTOFF * max(values[-1], 1e-300)
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T / np.outer(scale, scale)
    if kept.all():
        return inverse, 0
    size = np.where(size > 0.0, size, 1.0)  # a drive that never moved has no effect to be measured by
    open_directions = vectors[:, ~kept] * (size / scale)[:, None]
    basis = np.linalg.qr(open_directions)[0]
    shortest = np.eye(len(size)) - (basis / size[:, None]) @ (basis * size[:, None]).T
    shortest[np.diag(normal) == 0.0] = 0.0  # exactly, for what the data never touch: no rounding over rounding
    return shortest @ inverse @ shortest.T, int((~kept).sum())


def _leave_one_out(design: Array, covariance: Array, weight: Array, residuals: Array) -> Array:
    """Residuals of each row against the fit to all others: (I - H_nn)^-1 r_n with the hat matrix's blocks."""
    rest = np.eye(design.shape[1]) - design @ covariance @ design.transpose(0, 2, 1) @ weight
    if rest.shape[1] == 1:
        return np.divide(residuals, rest[:, 0], out=np.zeros_like(residuals), where=rest[:, 0] != 0.0)
    return np.einsum("nlk,nk->nl", np.linalg.pinv(rest, rcond=1e-9), residuals)


def keep_consistent(
    u: Array,
    y: Array,
    cov: Array,
    *,
    offset_cov: Array | None = None,
    fitted: Mask | None = None,
    false_rejections: float = 0.05,
) -> Mask:
    """Which responses (N, L) agree with the matrix model: gross errors found from a robust start, then to a fixpoint.

    ``false_rejections`` is the expected number of good values rejected in the whole table. The robust start is the
    least absolute deviation by reweighting; its median residual widens the limit where the noise is larger than
    declared. Rows outside ``fitted`` (N,) are judged by a fit that has not seen them. The rest is the predictive
    residual of each value in units of its own deviation.
    """
    from scipy.special import ndtri

    seen = np.isfinite(y)
    limit = -ndtri(0.5 * min(1.0, false_rejections / max(seen.sum(), 1)))
    basis = seen if fitted is None else seen & fitted[:, None]
    start = _standardised_l1(u, np.where(basis, y, np.nan), y, cov, offset_cov)
    limit *= max(1.0, float(np.median(start[basis])) / _NORMAL_MEDIAN) if basis.any() else 1.0
    kept = seen & (start < 1.5 * limit)
    for _ in range(20):
        fit = fit_response(u, np.where(kept & basis, y, np.nan), cov, offset_cov=offset_cov)
        again = seen & (_standardised(fit, u, y, cov) < limit)
        if (again == kept).all():
            break
        kept = again
    return kept


def _standardised(fit: ResponseFit, u: Array, y: Array, cov: Array) -> Array:
    """(N, L) |residual| in units of its deviation, for rejected values as well as for kept ones.

    A value that the fit has not seen misses by the error of K too, which is large where poses are few, and has no
    deviation along drives that were never varied.
    """
    fitted = np.isfinite(fit.residuals)
    residual = np.where(fitted, fit.residuals, y - fit.offset[0] - fit.predict(u))
    unseen = np.where(_spanned(u, fitted), fit.predicted_variance(u), np.inf)
    spread = np.sqrt(np.einsum("nll->nl", cov) + np.where(fitted, 0.0, unseen))
    return np.abs(np.nan_to_num(residual)) / np.where(spread > 0.0, spread, np.inf)


def _spanned(u: Array, fitted: Mask) -> Mask:
    """(N, L) whether drives (N, D) are combinations of those that each response was fitted to."""
    found = np.zeros(fitted.shape, bool)
    for k, rows in enumerate(fitted.T):
        _, size, along = np.linalg.svd(u[rows], full_matrices=False)
        basis = along[size > _SPANNED * size.max(initial=0.0)]
        rest = u - u @ basis.T @ basis
        found[:, k] = np.abs(rest).max(axis=1, initial=0.0) <= _SPANNED * np.abs(u).max(initial=0.0)
    return found


def _standardised_l1(u: Array, kept: Array, y: Array, cov: Array, offset_cov: Array | None) -> Array:
    """(N, L) |residual| in units of its deviation, of all y, after a least-absolute-deviation fit to those in kept."""
    inflated = cov
    for _ in range(30):
        fit = fit_response(u, kept, inflated, offset_cov=offset_cov)
        z = _standardised(fit, u, y, cov)
        root = np.sqrt(np.maximum(z, 1.0))
        inflated = cov * root[:, :, None] * root[:, None, :]
    return z


def residual_sets(fit: ResponseFit) -> dict[str, Array]:
    """Residuals of the fit, and of each row by a fit to all others."""
    return {"": fit.residuals, "cv_": fit.loo_residuals}


def fit_models(u: Array, y: Array, cov: Array, forms: tuple[str, ...], **prior: Any) -> dict[str, ResponseFit]:
    """Every model form fitted to the same data."""
    return {form: fit_response(u, y, cov, form=form, **prior) for form in forms}  # type: ignore[arg-type]


def entry_p_values(fit: ResponseFit, widened: float = 1.0) -> Array:
    """(L, D) two-sided p-value of each entry of K against zero; NaN where it is not in the model or not determined.

    ``widened`` multiplies the standard deviations, where the noise proved larger than declared.
    """
    from scipy.special import ndtr

    p = np.full(fit.free.shape, np.nan)
    sigma = np.sqrt(np.diag(fit.covariance)) * widened
    z = np.divide(fit.coefficients[fit.free], sigma, out=np.full(len(sigma), np.nan), where=sigma > 0.0)
    p[fit.free] = 2.0 * ndtr(-np.abs(z))
    return p


def holm_significant(p: Array, false_alarm: float) -> Mask:
    """Which of many tests hold together at the stated family-wise false-alarm rate (Holm 1979); NaN is never one."""
    tested = np.isfinite(p)
    significant = np.zeros(p.shape, bool)
    significant[tested] = holm_adjusted(p[tested]) <= false_alarm
    return significant


def gain_p_value(smaller: ResponseFit, larger: ResponseFit) -> float:
    """p-value of the larger of two nested models against the smaller: F where the noise level is estimated too.

    The noise level comes from the larger model's residuals, so noise declared 10 % wrong does not decide the test.
    Where these are nothing but rounding, as of points that repeat exactly, the declared noise decides (chi-square).
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
    """Whether K is symmetric within its uncertainty; for a full square K."""
    n = fit.free.shape[0]
    upper = np.triu_indices(n, 1)
    contrast = np.zeros((len(upper[0]), n * n))
    contrast[np.arange(len(upper[0])), upper[0] * n + upper[1]] = 1.0
    contrast[np.arange(len(upper[0])), upper[1] * n + upper[0]] = -1.0
    chi_square, p_value = _wald(contrast, fit)
    k = fit.coefficients
    return Symmetry(chi_square, len(contrast), p_value, float(np.linalg.norm(k - k.T) / 2.0 / np.linalg.norm(k)))


def pair_couplings(fit: ResponseFit) -> list[tuple[int, int, float, float]]:
    """For every pair of legs (from 0): i, j, coupling sqrt((K_ij^2 + K_ji^2)/2), and the p-value of no coupling."""
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
    """Number of independent shapes in K: the smallest rank that leaves no more than noise.

    K is whitened by its average row and column covariance; what the first r singular values leave is held against
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
    """How the attachments' shifts look round the ring: shares of the mean square, and the principal shape.

    lift, tilt, buckle sum to 1; buckle is what no plane explains. principal (L,): unit shape with the largest
    share over poses, principal_share its share, amplitude_um its largest amplitude.
    """

    lift: float
    tilt: float
    buckle: float
    principal: Array
    principal_share: float
    amplitude: float


def ring_shape(shifts: Array, attachments: Array) -> RingShape:
    """Split shifts (N, L) at attachment points (L, 3) into a lift, a tilt of the ring's plane, and its buckling."""
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
    """Factor on the standard deviations: above 1 only where the residuals are larger than declared noise allows."""
    from scipy.special import chdtrc

    if fit.dof <= 0 or chdtrc(fit.dof, fit.chi_square) > 0.01:
        return 1.0
    return float(np.sqrt(fit.chi_square / fit.dof))


def entry_tests(fit: ResponseFit) -> tuple[Array, Array, Mask]:
    """(L, D) sigma, p-value and significance of every entry, widened where the noise is larger than declared."""
    factor = birge(fit)
    p = entry_p_values(fit, factor)
    return fit.sigma * factor, p, holm_significant(p, FALSE_ALARM)
