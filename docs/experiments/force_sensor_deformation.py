"""Tables of docs/force-sensor-paper.md on deformation: Table 2, its contradictions, and the load along z."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from docs.experiments.force_sensor_sets import (
    ARCSEC,
    LENS_M,
    LOADS,
    SETS,
    UNITS,
    SensorSet,
    published,
    sigmas,
    three_fold,
)
from docs.experiments.force_sensor_statics import row
from docs.experiments.marked_tables import table
from truing.simulation.bench.six_upur.assembly import influence_coefficients, joined_links, sensor_chains
from truing.simulation.bench.six_upur.influence import roll_pitch_yaw
from truing.simulation.bench.six_upur.loading import AXES, UnitForces, share_wrench, two_units
from truing.simulation.bench.six_upur.stiffness import ElasticSensor
from truing.simulation.bench.six_upur.uncertain_sensor import compliance_change, compliance_covariance

FULL = 9000.0


def per_1000(sensor: ElasticSensor) -> NDArray:
    """Return the displacement (6,) along each load of 1000 N or N m, um and arc seconds (Table 2)."""
    return 1000.0 * UNITS * np.diag(sensor.compliance)


def table_2() -> str:
    """Return Table 2 as printed, of the sets, and of the three-fold sensor that comes nearest to it."""
    rows = [["in print", *(f"{value:.1f}" for value in published().table2.values), ""]]
    for name, each in {**SETS, "three-fold, best": best_three_fold()}.items():
        C = each.sensor().compliance
        size = np.sqrt(np.diag(C))
        coupling = np.abs(C / np.outer(size, size) - np.eye(6)).max()
        rows.append([name if len(name) > 1 else f"set {name}", *row(per_1000(each.sensor()), 1), f"{coupling:.2f}"])
    return table(["", *(f"{load}, {unit}" for load, unit in zip(LOADS, _names(), strict=True)), "coupling"], rows)


def _names() -> list[str]:
    return ["µm"] * 3 + ["arcsec"] * 3


@cache
def best_three_fold() -> SensorSet:
    """Return the three-fold sensor of the printed size whose logarithms come nearest to Table 2 in mean square."""
    from scipy.optimize import least_squares

    wanted = np.log(published().table2.values)

    def made(x: NDArray) -> SensorSet:
        thickness, axial, torsion = np.exp(x[2:])
        return three_fold(x[0], x[1], thickness=float(thickness), axial=float(axial), torsion=float(torsion))

    def off(x: NDArray) -> NDArray:
        return np.log(per_1000(made(x).sensor())) - wanted

    fits = []
    bounds = [0.0, 0.0, *np.log([2e-4, 1e5, 1e0])], [60.0, 120.0, *np.log([0.03, 1e9, 1e6])]
    for above in (15.0, 30.0, 45.0, 75.0, 100.0):
        start = np.array([20.0, above, *np.log([6e-3, 1e7, 3e3])])
        fits.append(least_squares(off, start, bounds=bounds, x_scale="jac"))
    return made(min(fits, key=lambda fit: float(fit.cost)).x)


def three_fold_radii() -> str:
    """Return the table of radii at half height that axial legs need for the ratios of Table 2, x and y averaged."""
    x, y, z, mx, my, mz = np.array(published().table2.values) / UNITS
    sideways, tilting = 0.5 * (x + y), 0.5 * (mx + my)
    low = sideways - (0.5 * SETS["S"].height) ** 2 * tilting  # at half height, where a force tilts nothing
    rows = [
        ["C_M / C_Fz = 2 / R²", f"{np.sqrt(2.0 * z / tilting):.3f}"],
        ["C_Mz / C_F = 1 / (2 R²)", f"{np.sqrt(low / (2.0 * mz)):.3f}"],
    ]
    return table(["three-fold, legs that only stretch", "R, m"], rows)


def maxima() -> str:
    """Return the theoretical maxima of figures 12 to 17, and the deformation that Table 2 gives for the loads."""
    print_ = published()
    rows = []
    for k, load in enumerate(LOADS):
        slope, shown = print_.table2.values[k], print_.maxima.theory[k]
        up, down = print_.maxima.positive[k], -print_.maxima.negative[k]
        cells = [f"{9 * slope}", f"{10 * slope}", f"{shown:.1f}", f"{shown / slope:.2f}"]
        rows.append([f"{load}, {_names()[k]}", *cells, f"{up / shown:.3f}, {down / shown:.3f}",
                     f"{0.5 * (up + down):.1f}", f"{0.5 * (up - down):+.1f}"])  # fmt: skip
    head = ["", "Table 2 times 9", "times 10", "theory in the figure", "load it implies, kN or kN m"]
    return table([*head, "measured over theory, +, −", "measured, odd part", "even part"], rows)


def arithmetic() -> str:
    """Return the relative errors of Table 5 and of eq. 35, recomputed."""
    print_ = published()
    final, with_error, ideal = (np.array(getattr(print_.table4, key)) for key in ("J_B_prime", "J_prime", "J"))
    G, G1, GB = print_.condition.G, print_.condition.G_prime, print_.condition.G_B_prime
    rows = []
    for name, values, condition, shown in (
        ("type 1, J' against J_B'", with_error, G1, print_.table5.type1_percent),
        ("type 2, J against J_B'", ideal, G, print_.table5.type2_percent),
    ):
        rows.append([name, *row(100 * np.abs(values / final - 1.0), 2), f"{100 * abs(condition / GB - 1.0):.2f}"])
        rows.append(
            ["in print", *row(np.array(shown), 2), f"{print_.condition.relative_error_percent[len(rows) // 3]:.2f}"]
        )
    return table(["%", *(f"S {load}" for load in LOADS), "cond"], rows)


def as_printed() -> str:
    """Return the table of equations with errors in print: the result as printed, and as corrected."""
    sensor = SETS["A"].sensor()
    joints = sensor.joints
    tilt = np.array([0, 0, 0, 780.0, 730.0, 690.0]) * ARCSEC
    sideways = 1e3 * (roll_pitch_yaw(tilt[3:]) @ joints.origin - joints.origin)[:2]
    J_F, own = sensor.leg_transport, np.linalg.inv(sensor.parts.compliance.sum(-3))
    K = (J_F @ own @ np.linalg.inv(np.swapaxes(J_F, -1, -2))).sum(0)
    right = sensor.leg_stiffness.sum(0)
    slopes = influence_coefficients(joined_links(sensor_chains(joints))).a[:, :3, 0]
    rows = [
        ["4", "moment part r_b × r_B", "all six moments with the wrong sign", "r_b × S: eq. 25 agrees"],
        ["8, 9", "sums from S_1", "the base's radius moves nothing",
         f"from a_01: {np.linalg.norm(slopes, axis=1).mean():.0f} µm of each open chain per µm"],
        ["14", "mean of open chains", "no attitude error from lengths", "closed loops: below"],
        ["24, 27", "J^i as printed", f"K not symmetric: {_asymmetry(K):.0f} % of its largest entry",
         f"its transpose's inverse: {_asymmetry(right):.0e} %"],
        ["30", "transposed rotation", "780 arcsec become −780", "Rz Ry Rx"],
        ["31", "rotation about the base's origin",
         f"780, 730, 690 arcsec move the platform {sideways[0]:+.2f}, {sideways[1]:+.2f} mm", "about its own: 0"],
    ]  # fmt: skip
    return table(["eq.", "in print", "what it gives, set A", "corrected"], rows)


def _asymmetry(K: NDArray) -> float:
    return float(100 * np.abs(K - K.T).max() / np.abs(K).max())


def along_z() -> str:
    """Return the table of explanations of the measured +428 and -207 um, with the size that each one needs."""
    odd, even = parts_along_z()
    rows = [
        ["the force offset from the centre, any amount", "odd", "impossible", ""],
        ["clearance, a cubic stiffness, a wrong scale", "odd", "impossible", ""],
        ["the zero stood elsewhere: no new zero, a slip, drift", "even", f"{1e6 * even:+.1f} µm", "seen at no load"],
        ["another stiffness when pulling", "even", f"{100 * 2 * even / odd:.0f} % asymmetry", "all readings of Fz"],
    ]
    for name in ("A", "N"):
        rows += imbalances(name, SETS[name].sensor(), odd, even)
    return table(["explanation", "part of d(F)", "needed", "seen elsewhere as"], rows)


def parts_along_z() -> tuple[float, float]:
    """Return the odd and the even part, m, of the displacement measured at +9 and -9 kN along z."""
    print_ = published()
    up, down = (1e-6 * values[2] for values in (print_.maxima.positive, print_.maxima.negative))
    return 0.5 * (up - down), 0.5 * (up + down)


def imbalances(name: str, sensor: ElasticSensor, odd: float, even: float) -> list[list[str]]:
    """Return table rows of the moment and offset of two units that give both parts of a displacement, m."""
    offset, moment = lever_arms(sensor, odd, even)
    excess = 50.0 * abs(moment) / LENS_M
    turned = FULL * abs(moment) * sensor.compliance[4, 4] / ARCSEC
    shares = f"units at ±{LENS_M} m share {50 + excess:.1f} : {50 - excess:.1f}, the other way when pulling"
    seen = f"the same, seen {LENS_M} m off the centre, set {name}"
    return [
        [
            f"a moment that differs when pulling, seen at the centre, set {name}",
            "even",
            f"{2 * abs(even / (sensor.compliance[2, 4] * FULL)):.1f} N m per N",
            "absurd",
        ],
        [seen, "even", f"{2 * abs(moment):.3f} N m per N: {shares}", f"{turned:.0f} arcsec about y"],
        ["in addition, for the slope: a plain offset", "odd", f"{1e3 * abs(offset):.0f} mm", "tilt that follows F"],
    ]


def lever_arms(sensor: ElasticSensor, odd: float, even: float) -> tuple[float, float]:
    """Return the moments about y per N, m, that give both parts of a displacement, m, at a lens on the x axis.

    First the one that follows the force, an offset, then the one that keeps its sign.
    """
    lens = sensor.compliance[2] - LENS_M * sensor.compliance[4]
    return (odd / FULL - lens[2]) / lens[4], even / FULL / lens[4]


def units_at_rim(sensor: ElasticSensor, odd: float, even: float) -> UnitForces:
    """Return the two units that give both parts of a displacement, m, seen by a lens off the centre."""
    offset, moment = lever_arms(sensor, odd, even)
    excesses = (-(offset + sign * moment) / (2.0 * LENS_M) for sign in (1.0, -1.0))
    return two_units("fz", (LENS_M, 0.0, 0.0), *excesses)


# Torques by two units, with the axis on which the paper's section 6 places them.
_COUPLES = (("mx", "y"), ("my", "x"), ("mz", "x"), ("mz", "y"))


def torques() -> str:
    """Return the shares of two units that would give the even part of each measured rotation."""
    printed = published().maxima
    rows = []
    for axis, side in _COUPLES:
        k = AXES.index(axis)
        even = 0.5 * (printed.positive[k] + printed.negative[k])
        wrench = share_wrench(axis, LENS_M * np.eye(3)["xyz".index(side)])
        force = int(np.abs(wrench[:3]).argmax())
        shares = [_shares(even * ARCSEC, FULL * (each.sensor().compliance[k] @ wrench)) for each in SETS.values()]
        rows.append([f"M{axis[1]}, units on ±{side}", f"F{'xyz'[force]}", f"{even:+.1f}", *shares])
    return table(["torque", "force that it brings", "even part, arcsec", *(f"set {name}" for name in SETS)], rows)


def _shares(even: float, per_excess: float) -> str:
    """Return the shares that give an even part; "impossible" for a force that does not turn the platform."""
    if abs(per_excess) < 1e-6 * abs(even):
        return "impossible: it does not turn"
    excess = 100.0 * even / per_excess
    return f"{50 + excess:.1f} : {50 - excess:.1f}" if abs(excess) < 50.0 else "more than the whole load"


def prior() -> str:
    """Return the prior uncertainty of the compliance, %, by tolerances and by 5 % uncertainty of the stiffnesses."""
    rows = []
    for name, each in SETS.items():
        sensor = each.sensor()
        change = compliance_change(sensor)
        common = change.by_stiffness.sum(0)
        for what, slopes, sigma in (
            ("tolerances", change.by_source, sigmas()),
            ("5 % of each element, common to the legs", common, np.full(len(common), 0.05)),
            ("5 % of each element of each leg", change.by_stiffness, np.full(len(common), 0.05)),
        ):
            variance = np.diag(compliance_covariance(slopes, sigma)).reshape(6, 6).diagonal()
            relative = 100 * np.sqrt(variance) / np.diag(sensor.compliance)
            rows.append([f"set {name}", what, *row(relative, 3 if what == "tolerances" else 2)])
    return table(["", "not known", *(f"C {load}, %" for load in LOADS)], rows)


def softest() -> str:
    """Return the share of each element of the leg in the displacement along each load, %."""
    rows = []
    names = ("lower universal joint", "force sensor", "upper universal joint", "revolute joint")
    for name, each in SETS.items():
        sensor = each.sensor()
        common = compliance_change(sensor).by_stiffness.sum(0)
        for part, slopes in zip(names, common, strict=True):
            rows.append([f"set {name}", part, *row(-100 * np.diag(slopes) / np.diag(sensor.compliance), 1)])
    return table(["", "gives, % of", *LOADS], rows)
