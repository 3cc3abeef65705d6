"""Tables of docs/telescope-report.md on the report's statements: each next to the value from this code."""

from __future__ import annotations

from functools import cache

import numpy as np

from docs.experiments.marked_tables import table
from docs.experiments.telescope_report_absorption import simulated
from docs.experiments.telescope_report_claims import (
    AXES,
    choices,
    configurations_needed,
    deformation,
    distance_from_nominal,
    excursion_of_table,
    excursion_of_workspace,
    longest_flexure,
    pairs_on_base,
    reach_of_axis,
    sensitivity,
    travel_of_all,
    travel_of_axis,
    travel_of_tilt_and_lift,
    uniqueness,
)
from docs.experiments.telescope_report_data import published
from docs.experiments.telescope_report_geometry import best_shape
from docs.experiments.telescope_report_models import STRUCTURES, accuracy, calibration, misfit
from docs.experiments.telescope_report_side import (
    choice,
    directions,
    rows_of_K,
    squared_singular_values,
    starts,
    stiffness_parameters,
    with_reference,
)
from docs.experiments.telescope_report_tables import rms

MODELS = {"a": "6-PUS", "b": "Jacobian", "c": "beam", "d": "stiffness"}
KNOWN = {"5": "none", "6": "linear", "7": "matrix"}


def _mm(value: float) -> str:
    return f"{1e3 * value:.2f} mm"


def workspace() -> str:
    """Return the table of the travel that the workspace of Table 1 takes, and of the excursion of Tables 3 and 4."""
    alone = ", ".join(f"{name} {1e3 * travel_of_axis(i):.2f}" for i, name in enumerate(AXES))
    level, best = travel_of_all()
    reach = [reach_of_axis(i) for i in range(6)]
    lengths, angles = 1e3 * np.array(reach[:3]), np.degrees(reach[3:])
    of_set, of_check, of_workspace = excursion_of_table(3), excursion_of_table(4), excursion_of_workspace()
    stood, tilted = 1e3 * of_set.position, np.degrees(of_set.angle)
    rows = [
        ["travel for half a width of one axis alone, mm", "±1.3", alone],
        ["travel for half widths of any tilt and z together", "±1.3 mm", _mm(travel_of_tilt_and_lift())],
        ["travel for all five half widths at once", "±1.3 mm", f"{_mm(level)}; {_mm(best)} with the best θ_z"],
        ["reach of ±1.3 mm, one axis alone", "", _six(lengths, angles)],
        ["Table 3 takes the platform to", "inside W", _six(stood, tilted)],
        ["configurations of Table 3, Table 4 inside W", "all", f"{of_set.inside} of 40, {of_check.inside} of 6"],
        ["of these inside in tilt alone", "all", f"{of_set.tilt_inside} of 40, {of_check.tilt_inside} of 6"],
        ["legs turn by at most: in W; at Table 3", "0.6°", _degrees(of_workspace.leg, of_set.leg)],
        [
            "upper flexures bend by at most: in W; at Table 3",
            "1°",
            _degrees(of_workspace.upper_flexure, of_set.upper_flexure),
        ],
        [
            "flexure length up to which 1° moves a leg by less than 0.3 µm",
            "not printed",
            f"{1e3 * longest_flexure(np.radians(1.0)):.1f} mm",
        ],
    ]
    return table(["statement", "report", "ours"], rows)


def _six(lengths: np.ndarray, angles: np.ndarray) -> str:
    return f"{', '.join(f'{x:.1f}' for x in lengths)} mm; {', '.join(f'{x:.2f}' for x in angles)}°"


def _degrees(one: float, other: float) -> str:
    return f"{np.degrees(one):.2f}°; {np.degrees(other):.2f}°"


def statements() -> str:
    """Return statements that one number settles."""
    rows = [*_of_actuators(), *_of_proofs(), *_of_K(), *_of_configurations(), *_of_tables()]
    return table(["statement", "report", "ours"], rows)


def _of_actuators() -> list[list[str]]:
    s = sensitivity()
    lever = 1e-6 * published().stated["actuator_accuracy"] / np.radians(1e-6)
    return [
        ["position off by at most, ±1 µm in the actuators (2.3)", "6 µm", f"{1e6 * s.position:.2f} µm"],
        [
            "orientation off by at most, about x or y; about z (2.3)",
            "1e-6°",
            f"{np.degrees(s.tilt):.1e}°; {np.degrees(s.turn):.1e}°",
        ],
        ["lever at which 1 µm is 1e-6°", "-", f"{lever:.0f} m"],
    ]


def _of_proofs() -> list[list[str]]:
    rigid_legs, beam = uniqueness()
    said = ["proven" if proof.unique and proof.inverse_unique.all() else "not decided" for proof in (rigid_legs, beam)]
    needed = [f"{one.model} {one.configurations} ({one.parameters} parameters)" for one in configurations_needed()]
    return [
        [
            "in W, one pose for its readings and one reading for each pose: rigid legs; flexures (eq. 18)",
            "proven near nominal Δl",
            "; ".join(said),
        ],
        ["configurations that a model needs at least (6.3.3)", "stiffness 12", ", ".join(needed)],
    ]


def _of_K() -> list[list[str]]:
    K = published().K
    of_K = deformation(float(np.mean(simulated(best_shape().machine, "6a").rows["kappa"] + np.diag(K))))
    own = f"{of_K.kappa_by_regression:.4f} (regression), {of_K.kappa_by_calibration:.4f} (calibration)"
    identified = f"{np.mean(published().kappa('6a')):.4f} (Table 6a), {np.mean(np.diag(K)):.4f} (mean K_ii)"
    return [
        ["κ, initial (3.2)", "0.011", f"{own}; {identified}"],
        ["largest shift of an attachment at Table 3 (3.2)", "±60 µm", f"{1e6 * of_K.largest_shift:.0f} µm by eq 4"],
        ["largest row sum of K: a pure lift does not bend the ring", "-", f"{1e3 * of_K.row_sum:.0f}e-3"],
        [
            "share of K's squares that is heave, tip and tilt of the attachments",
            "a buckled wheel",
            f"{100 * of_K.rigid_share:.0f} %",
        ],
    ]


def _of_configurations() -> list[list[str]]:
    drawn = choices(50)
    above = int(np.sum(drawn.corners > drawn.table))
    determinants = ", ".join(
        f"{x.mean():.0f} ± {x.std(ddof=1):.0f}" for x in (drawn.corners, drawn.levels, drawn.uniform)
    )
    return [
        ["log det JᵀJ of Table 3 (6.3)", "the largest", f"{drawn.table:.0f}"],
        ["log det of random sets: all at ±1; at −1, 0, 1; anywhere", "smaller", determinants],
        ["of 50 random sets at ±1, better than Table 3", "none", f"{above}"],
    ]


def _of_tables() -> list[list[str]]:
    near, whole = pairs_on_base("6a"), pairs_on_base("7a")
    rows = [
        ["close pairs on the base nearer each other, mm: 6a; 7a (7.4)", "smaller α0", f"{_list(near)}; {_list(whole)}"],
    ]
    for letter in "67":
        away = np.abs(accuracy(f"{letter}a")[0].away).T * 1e6
        reached = "; ".join(f"{rms(axis):.1f}, {axis.max():.1f}" for axis in away)
        rows.append(
            [f"{KNOWN[letter]}, no noise, 40 poses: x; y; z: rms, largest, µm (8)", "some micrometres", reached]
        )
    for letter, name in MODELS.items():
        far = ", ".join(f"{distance_from_nominal(number + letter):.2f}" for number in "567")
        rows.append([f"{name}: a and b from nominal, rms, mm: Tables 5, 6, 7", "7 is closest", far])
    return rows


def _list(values: np.ndarray) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def models() -> str:
    """Return the table of the twelve calibrations without noise: residuals and pose errors."""
    rows = []
    for number, known in KNOWN.items():
        for letter, name in MODELS.items():
            found, (at_three, at_four) = calibration(number + letter), accuracy(number + letter)
            errors = [f"{a:.1f}, {b:.1f}" for e in (at_three, at_four) for a, b in (e.shown()[:2], e.shown()[2:])]
            left = f"{1e6 * rms(found.residual):.1f}"
            rows.append([f"{number}{letter}", name, known, left, *errors])
    head = ["table", "model", "deformation", "residual, rms, µm", "40 poses: µm", "arcsec", "6 poses: µm", "arcsec"]
    return table(head, rows)


def linear_models() -> str:
    """Return the table of reading errors by model at Table 3 where the truth is 6-PUS without deformation."""
    rows = []
    for letter in "bcd":
        found = misfit(letter)
        cells = [f"{1e6 * rms(x):.2f}, {1e6 * np.abs(x).max():.2f}" for x in (found.nominal, found.calibrated)]
        rows.append([MODELS[letter], *cells])
    return table(
        ["model against 6-PUS", "same geometry: rms, largest, µm", "after its calibration: rms, largest, µm"], rows
    )


def deformation_choice(draws: int = 20) -> str:
    """Return the table of pose errors at Table 4, by deformation, if attachments shift by 5 um besides K."""
    rows = []
    for letter in "ab":
        for known in KNOWN.values():
            c = choice(letter, known, draws)
            position = f"{c.position_mean:.0f} ± {c.spread:.0f}, {c.position_max:.0f}"
            rows.append([MODELS[letter], known, position, f"{c.orientation_mean:.0f}, {c.orientation_max:.0f}"])
    return table(["model", "deformation", "6 poses, mean and largest: µm", "arcsec"], rows)


def direction_choice() -> str:
    """Return Table 5a's fit with one, the other or both components of u (7.1.1)."""
    rows = []
    for name, found in directions().items():
        mean, most, turn, turned = found.verification.shown()
        left = f"{1e6 * found.left:.2f}"
        status = str(found.calibration.solution.status[0])
        rows.append([name, left, f"{mean:.1f}, {most:.1f}", f"{turn:.1f}, {turned:.1f}", status])
    return table(["identified of u", "residual, rms, µm", "6 poses: µm", "arcsec", "status"], rows)


@cache
def _references() -> tuple[str, ...]:
    rows = []
    for name, found in zip(("without ρ⁰", "with ρ⁰"), with_reference(), strict=True):
        values = squared_singular_values(found.calibration, STRUCTURES["b"])
        mean, most, *_ = found.verification.shown()
        small = int(np.sum(values < published().stated["rho0_singular_values_below"]))
        left, status = f"{1e6 * found.left:.3f}", str(found.calibration.solution.status[0])
        least = values[values > published().stated["rho0_singular_values_below"]].min()
        rows.append((name, left, f"{mean:.2f}, {most:.2f}", f"{small}", f"{least:.1e}", status))
    return tuple("\t".join(row) for row in rows)


def reference_readings() -> str:
    """Return the Jacobian model's fit without and with rho0 (7.1.2)."""
    head = ["Jacobian model", "residual, rms, µm", "6 poses: µm", "JᵀJ below 1e-14", "smallest of the others", "status"]
    return table(head, [row.split("\t") for row in _references()])


def stiffnesses() -> str:
    """Return the relative standard deviations of the six stiffnesses from poses (7.1.4)."""
    found = stiffness_parameters()
    rows = []
    for i, label in enumerate(found.labels):
        if label.startswith(("flexure", "tube")):
            share = found.sigma_with_prior[i] / found.scales[i]
            rows.append([label.replace("_", " "), "yes" if found.identifiable[i] else "no", f"{share:.3f}"])
    text = table(["stiffness", "identifiable", "sigma after 40 poses, if known to 100 % before"], rows)
    nulls = int(np.sum(found.singular_values < found.rounding * 10))
    return f"{text}\n\nRank {found.rank} of {len(found.labels)}; {nulls} combinations are null to rounding."


def rows_from_poses() -> str:
    """Return the information of poses alone on geometry and a leg's row of K (7.3)."""
    rows = []
    for leg, found in enumerate(rows_of_K(), 1):
        values = ", ".join(f"{value:.1e}" for value in found.singular_values[found.rank - 1 : found.rank + 2])
        rows.append([f"{leg}", f"{found.rank} of {len(found.labels)}", values])
    return table(["leg", "combinations that poses determine", "last one that counts, and the next two"], rows)


def many_starts() -> str:
    """Return the table of the minima that many starts reach by both methods (7)."""
    rows = []
    for name, ratio in (("5a", 0.01), ("5a", 0.1), ("6a", 0.01), ("7a", 0.01), ("5b", 0.01)):
        found = starts(name, ratio)
        for method, minima in found.minima.items():
            reached = ", ".join(f"{n}" for n in minima.reached)
            worse = " ".join(f"{100 * (cost / minima.cost[0] - 1):.2f}" for cost in minima.cost[1:])
            rows.append([name, f"0.5 mm, {ratio:g}", method, reached, worse or "-", f"{minima.failed}"])
    head = ["fit", "starts off by", "method", "starts per minimum", "sum of squares above the lowest, %", "failed"]
    return table(head, rows)
