"""Tables of docs/telescope-report.md on the machine: its shape, the bias by K, and the remainder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import table
from docs.experiments.telescope_report_absorption import KNOWS, by_row, leg_fits, shift_by_K, simulated
from docs.experiments.telescope_report_data import LENGTHS, published
from docs.experiments.telescope_report_geometry import (
    FOUR,
    ROUNDING_MM,
    best_shape,
    best_single_entry,
    chi_square,
    fit_shape,
    held_out,
    jackknife,
    misfit_of_the_real_machine,
    observed,
    rivals,
    scatter_by_K,
    sigma_of_K,
    weighted_shape,
)
from docs.experiments.telescope_report_remainder import (
    CAUSES,
    FRAMES,
    ROWS,
    TOGETHER,
    Ignorance,
    explain,
    findings,
    remainder,
)
from truing.estimation.least_squares.solver import SolverStatus

# What section 6.3.2 takes for the uncertainty of a parameter.
BY = Ignorance(published().stated["sim_parameter_uncertainty"])
SIGNS = {"a_x": "Δa_x, mm", "a_y": "Δa_y, mm", "b_x": "Δb_x, mm", "b_y": "Δb_y, mm", "l": "Δl, mm"}
SIGNS |= {"u_x": "u_x", "kappa": "Δκ, 1e-3"}


def rms(values: NDArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def correlation(one: NDArray, other: NDArray) -> float:
    """Return the correlation of two arrays."""
    return float(np.corrcoef(np.ravel(one), np.ravel(other))[0, 1])


def probability(p: float) -> str:
    """Return a probability with one digit."""
    return f"{p:.2f}" if p > 0.01 else f"{p:.0e}"


def _pm(value: float, sigma: float, digits: int = 1) -> str:
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def _in_tables(name: str) -> float:
    """Return the factor that converts a number of the shape from m or rad to mm or degrees."""
    return 1e3 if name.endswith(("radius", "length")) else 180 / np.pi


def shape() -> str:
    """Return the four numbers, by three accounts of their uncertainty."""
    fit, weighted, spread = best_shape(), weighted_shape(), jackknife()
    rows = []
    for i, name in enumerate(FOUR):
        k, unit = _in_tables(name), "mm" if name.endswith("radius") else "°"
        rows.append(
            [
                f"{name}, {unit}",
                _pm(k * fit.numbers[i], k * fit.sigma[i]),
                f"{k * spread[i]:.1f}",
                _pm(k * weighted.numbers[i], k * weighted.sigma[i]),
            ]
        )
    return table(["number of the design", "inferred", "± by leaving legs out", "weighted by K's error"], rows)


def variants() -> str:
    """Return the table of fits of the shape with one more free number each."""
    rows = []
    names = {"turned": "whole pattern turned, °", "twist": "platform against base, °", "leg length": "leg length, mm"}
    for extra in (("turned",), ("twist",), ("leg length",)):
        fit, k = fit_shape(extra=extra), _in_tables(extra[0])
        moved = 1e3 * (fit.numbers[:2] - best_shape().numbers[:2])
        found = _pm(k * fit.numbers[-1], k * fit.sigma[-1])
        rows.append([names[extra[0]], found, f"{fit.rms:.3f}", f"{moved[0]:+.1f}, {moved[1]:+.1f}"])
    return table(["free in addition", "found", "rms left, mm", "base, platform radius move by, mm"], rows)


def rival_numberings() -> str:
    """Return the best of all other numberings of the legs."""
    chosen, rows = best_shape(), []
    for fit in [chosen, *rivals()[:6]]:
        p = fit.pattern
        side, sense = ("platform" if p.platform else "base"), ("counterclockwise" if p.turning > 0 else "clockwise")
        ended = "minimum" if fit.status == SolverStatus.CONVERGED else "no minimum"
        where = f"{np.degrees(p.towards):.0f}°"
        rows.append([side, sense, where, f"{fit.rms:.2f}", f"{fit.correlation:.2f}", ended])
    head = ["legs 1, 2 close on the", "numbers rise", "legs 1, 2 stand towards", "rms left, mm", "r", "fit ended at"]
    return table(head, rows)


def legs_held_out() -> str:
    """Return the table of the errors of each leg's shift as predicted by the shape fitted to the other five."""
    off = held_out() - observed()
    rows = [["rms shift of the leg, mm", *(f"{rms(column):.2f}" for column in observed().T)]]
    rows.append(["predicted by the other five to, mm", *(f"{rms(column):.2f}" for column in off.T)])
    return table(["leg", *"123456"], rows)


def misfit() -> str:
    """Return the table of the shape's misfit, and of the error of K that would explain it."""
    fit, (entry, share) = best_shape(), best_single_entry()
    rounding = 1e-3 / np.sqrt(12)
    by_rounding = float(np.sqrt(np.mean(np.einsum("irr->ir", scatter_by_K(rounding)))))
    rows = [
        ["shifts in print, rms", f"{rms(observed()):.2f} mm"],
        ["left by the four numbers, rms", f"{fit.rms:.2f} mm"],
        ["correlation", f"{fit.correlation:.3f}"],
        [
            "the same with the machine of Table 7a as truth, all fits nonlinear",
            f"{misfit_of_the_real_machine():.2f} mm",
        ],
        ["share of it that the best single entry of K would take, as a square", f"{100 * share:.0f} % ({entry})"],
        ["what K's rounding to 1e-3 leaves, rms", f"{by_rounding:.2f} mm"],
        ["what the tables' rounding leaves, rms", f"{ROUNDING_MM:.3f} mm"],
        ["χ² if K is known to its rounding (20 expected)", f"{chi_square(rounding):.0f}"],
        ["error of K's entries that would explain it", f"{1e3 * sigma_of_K():.2f}e-3"],
    ]
    return table(["quantity", "value"], rows)


def checks() -> str:
    """Return relations that the fit of the shape did not use."""
    r = relations()

    def signed(values: NDArray, digits: int) -> list[str]:
        return [f"{value:.{digits}f}" for value in values]

    rows = [
        ["z_x/z_z of the leg: from u_x (5a) and κ (6a)", *signed(r.slope, 3)],
        ["± by rounding of u_x", *signed(r.slope_sigma, 3)],
        ["z_x/z_z: from the inferred shape", *signed(r.slope_of_shape, 3)],
        ["u_x: in print (5a)", *signed(published().tables["5a"]["u_x"], 2)],
        ["u_x: from κ (6a) and the shape", *signed(r.u_x, 3)],
        ["ρ⁰, mm: from a_x (5a, 6a) and u_x", *signed(r.rho0, 1)],
        ["± by rounding", *signed(r.rho0_sigma, 1)],
    ]
    pooled = "ρ⁰ of all legs together: {:.2f} ± {:.2f} mm.".format(*reference_reading())
    return table(["relation, leg", *"123456"], rows) + "\n\n" + pooled


def absorption(name: str) -> str:
    """Return for Table 5a or 6a, row by row, what K makes of the parameters against what was identified."""
    full, seen = simulated(best_shape().machine, name), published().moved(name)
    machine = best_shape().machine
    first, by_K = by_row(full.parameters, leg_fits(machine, name).shift.ravel()), shift_by_K(machine, name)
    if KNOWS[name] == "linear":
        by_K[np.arange(6), :, np.arange(6)] = 0.0
    held, rows = held_out() - observed(), []
    for row, values in seen.items():
        unit = 1e3 if row == "kappa" else 1.0
        k = list(full.rows).index(row)
        expected = sigma_of_K() * rms(np.linalg.norm(by_K[:, k], axis=-1)) * 1e3
        cells = [
            f"{correlation(full.rows[row], values):.3f}",
            f"{unit * rms(full.rows[row] - values):.3f} of {unit * rms(values):.3f}",
            f"{correlation(first[row], values):.3f}, {unit * rms(first[row] - values):.3f}",
            "-" if row == "u_x" else f"{expected:.3f}",
        ]
        if name == "6a":
            cells.append("-" if row == "kappa" else f"{rms(held[LENGTHS.index(row)]):.3f}")
        rows.append([SIGNS[row], *cells])
    head = ["row", "r", "rms left of rms observed", "first order: r, rms left", "K's error leaves, rms"]
    return table([*head, "a leg from the other five, rms left"] if name == "6a" else head, rows)


def left_over() -> str:
    """Return the rms deviations of Table 7a from nominal, before and after fits of frames and common numbers."""
    parts = {"as printed": None, "frames fitted": (), "frames and five common numbers fitted": TOGETHER}
    rows = []
    for name, causes in parts.items():
        if causes is None:
            values = remainder()
            at = [
                values[[ROWS.index(row) for row in group]]
                for group in (("a_x", "a_y", "b_x", "b_y"), ("l",), ("kappa",))
            ]
            rows.append([name, *(f"{rms(value):.2f}" for value in at), "", ""])
            continue
        found = explain(causes, BY)
        cells = [found.rms("a_x", "a_y", "b_x", "b_y"), found.rms("l"), found.rms("kappa")]
        judged = f"{found.chi_square:.0f} of {found.freedom}", probability(found.p)
        rows.append([name, *(f"{cell:.2f}" for cell in cells), *judged])
    expected = np.sqrt(np.einsum("irr->ri", BY.covariance()))
    groups = [expected[:4], expected[ROWS.index("l")], expected[ROWS.index("kappa")]]
    rows.append(["expected: 0.5 mm, 5 µm of noise, K's error", *(f"{rms(group):.2f}" for group in groups), "", ""])
    return table(["Table 7a", "a, b: rms, mm", "l: rms, mm", "κ: rms, 1e-3", "χ²", "p"], rows)


def causes() -> str:
    """Return each single candidate, in addition to the frames."""
    rows = []
    for finding in findings(BY):
        many = min(1.0, finding.p_any * len(CAUSES))
        size = f"{_pm(finding.size, finding.sigma)} {finding.unit}"
        rows.append([finding.name, size, f"{finding.gain:.0f}", probability(finding.p), probability(many)])
    return table(["candidate, on its own", "size", "takes off χ²", "p", "p of the best of all, any scatter"], rows)


def together() -> str:
    """Return the five common numbers and the frames, fitted at once."""
    found = explain(TOGETHER, BY)
    units = FRAMES | CAUSES
    order = [*range(len(FRAMES), len(found.names)), *range(len(FRAMES))]
    pulls = found.sizes / found.sigma
    sizes = [
        f"{_pm(*pair)} {units[name][0]}" for name, *pair in zip(found.names, found.sizes, found.sigma, strict=True)
    ]
    rows = [[found.names[i], sizes[i], f"{pulls[i]:+.1f}"] for i in order]
    return table(["fitted together", "size", "in sigma"], rows)


def kappa_readings() -> str:
    """Return the table that tests the nominal value from which Table 7 counts kappa."""
    rows = []
    for name, nominal in (("K_ii of eq. 4", np.diag(published().K)), ("0.011", published().stated["kappa_initial"])):
        found = kappa_reading(nominal)
        seen = " ".join(f"{value:.1f}" for value in found.observed)
        rows.append([f"counted from {name}", seen, f"{found.chi_square:.1f}", probability(found.p)])
    predicted = " ".join(f"{value:.1f}" for value in kappa_reading(0.0).predicted)
    rows.append(["predicted from K", predicted, "", ""])
    return table(["κ of 6a less κ of 7a", "legs 1 to 6, 1e-3", "χ² of 6", "p"], rows)


def held() -> str:
    """Return Table 7c as a fit whose kappa was held."""
    found = held_kappa()
    largest = 1e3 * float(np.abs(published().tables["7c"]["kappa"]).max())
    rows = [
        ["7c less 7a, rms over a, b, l", f"{rms(found.observed):.2f} mm"],
        ["left when 7a's κ is moved to 7c's and held there", f"{rms(found.observed - found.predicted):.2f} mm"],
        ["correlation", f"{found.correlation:.3f}"],
        ["largest Δκ of 7c", f"{largest:.2f}e-3"],
        ["5c less 5a, 6c less 6a, largest of a, b, l", f"{_beam_moves():.2f} mm"],
    ]
    return table(["Table 7c", "value"], rows)


def _beam_moves() -> float:
    tables = published().tables
    return max(float(np.abs(tables[f"{t}c"][n] - tables[f"{t}a"][n]).max()) for t in "56" for n in LENGTHS)


@dataclass(frozen=True)
class Relations:
    """Checks that the fit of the shape does not use, leg by leg (6,)."""

    slope: NDArray  # z_x / z_z from u_x of Table 5a and kappa of 6a
    slope_sigma: NDArray  # by the rounding of u_x to 0.01
    slope_of_shape: NDArray
    u_x: NDArray  # from kappa and the slope of the shape
    rho0: NDArray  # mm, -(a_x of 5a less a_x of 6a) / u_x
    rho0_sigma: NDArray


def relations() -> Relations:
    """Return two relations of Tables 5a and 6a: kappa = u_x^2/2 - u_x z_x/z_z, and a_x moves by -rho0 u_x (eq. 40)."""
    u, kappa = published().tables["5a"]["u_x"], published().kappa("6a")
    legs = best_shape().machine.legs
    height = np.sqrt(legs.l**2 - np.sum((legs.b - legs.a)[:, :2] ** 2, -1))
    shape_slope = (legs.b - legs.a)[:, 0] / height
    moved = published().tables["5a"]["a_x"] - published().tables["6a"]["a_x"]
    rounding = 0.01 / np.sqrt(12)
    return Relations(
        slope=u / 2 - kappa / u,
        slope_sigma=rounding * np.abs(0.5 + kappa / u**2),
        slope_of_shape=shape_slope,
        u_x=shape_slope - np.sign(shape_slope) * np.sqrt(shape_slope**2 + 2 * kappa),
        rho0=-moved / u,
        rho0_sigma=np.hypot(ROUNDING_MM / u, rounding * moved / u**2),
    )


def reference_reading() -> tuple[float, float]:
    """Return rho0, mm, pooled over the legs, and its standard deviation."""
    found = relations()
    weight = 1 / found.rho0_sigma**2
    return float(np.sum(weight * found.rho0) / weight.sum()), float(weight.sum() ** -0.5)


@dataclass(frozen=True)
class Reading:
    """Agreement of Tables 6a and 7a about kappa if Table 7 is counted from a nominal value."""

    observed: NDArray  # (6,) 1e-3, kappa of 6a less kappa of 7a
    predicted: NDArray
    sigma: NDArray
    chi_square: float
    p: float


def kappa_reading(nominal: NDArray | float) -> Reading:
    """Return the test of kappa of 6a less 7a against K's absorption, if Table 7 counts kappa from ``nominal`` (6,)."""
    from scipy.stats import chi2

    tables = published()
    fits = leg_fits(best_shape().machine, "6a")
    seen = 1e3 * (tables.kappa("6a") - nominal - tables.tables["7a"]["kappa"])
    # next to the diagonal, which 7a fits as 6a does
    by_K = 1e3 * shift_by_K(best_shape().machine, "6a")[:, ROWS.index("kappa")]
    by_K[np.arange(6), np.arange(6)] = 0.0
    # 7a's own kappa started from K_ii, so that the shift is the off-diagonal part's
    predicted, sigma = 1e3 * fits.shift[ROWS.index("kappa")], sigma_of_K() * np.linalg.norm(by_K, axis=1)
    total = float(np.sum(((seen - predicted) / sigma) ** 2))
    return Reading(seen, predicted, sigma, total, float(chi2.sf(total, 6)))


@dataclass(frozen=True)
class HeldKappa:
    """Table 7c less 7a, and what holding kappa at 7c's values would make of a fit that otherwise is 7a's."""

    observed: NDArray  # (5 rows, 6 legs) mm
    predicted: NDArray

    @property
    def correlation(self) -> float:
        """Return the correlation over all entries."""
        return float(np.corrcoef(self.observed.ravel(), self.predicted.ravel())[0, 1])


def held_kappa() -> HeldKappa:
    """Return the reading of Table 7c as a fit whose kappa hardly moved."""
    jacobian = leg_fits(best_shape().machine, "6a").jacobian
    free = [k for k, name in enumerate(ROWS) if name != "kappa"]
    difference = remainder("7c") - remainder("7a")
    by_kappa = jacobian[..., ROWS.index("kappa")] * difference[ROWS.index("kappa"), :, None]
    answer = -np.einsum("irn,in->ri", np.linalg.pinv(jacobian[..., free]), by_kappa)
    return HeldKappa(difference[free], answer)
