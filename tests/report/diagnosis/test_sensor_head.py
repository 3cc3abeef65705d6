"""Every cause on a force sensor's bench has its sentence: subject and size in units of a force laboratory."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.report.bench_tables import bench_tables
from tests.report.diagnosis_tables import row, rows, size
from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.report.page_head import build_head
from truing.report.wordings.bench_wordings import BENCH
from truing.report.wordings.claim import Claim, ParameterSize
from truing.report.wordings.nonparametric_wordings import FOLLOWED


def test_the_units_of_a_torque_are_exchanged_and_those_of_a_force_driven_one_by_one():
    """One unit alone applies a force, but no couple."""
    advice = BENCH["load-imbalance"].advice
    assert_says(
        advice(Claim(cause="load-imbalance", subject="load mx")), "Exchange the two units of mx", "change its sign"
    )
    assert_says(advice(Claim(cause="load-imbalance", subject="load fz")), "Drive fz with one unit at a time")


def test_lines_of_action_that_lie_apart_are_measured_at_the_stand():
    """The data show the distance between them, but not which one is off the axis."""
    forms = {"components": ("z",), "forms": ("", "_asymmetry")}
    claim = Claim(cause="load-imbalance", subject="load fx", settings=forms)
    advice = BENCH["load-imbalance"].advice(claim)
    assert_says(advice, "positive and of negative fx pass along y")
    assert_says(advice, "only signals are recorded", "do not show which")


@pytest.mark.parametrize(
    ("axis", "about"), [("fx", "y"), ("fx", "z"), ("fy", "x"), ("fy", "z"), ("fz", "x"), ("fz", "y")]
)
def test_an_arm_is_on_the_side_whose_cross_product_gives_the_moment(axis, about):
    sizes = (ParameterSize(f"moment_{about}_asymmetry", 0.004, 1e-5, "m"),)
    reported = BENCH["load-imbalance"].clause(Claim(cause="load-imbalance", subject=f"load {axis}", sizes=sizes))
    side, across = re.search(r"towards (.)([xyz])$", reported).groups()
    arm = np.eye(3)["xyz".index(across)] * (0.004 if side == "+" else -0.004)
    moment = np.cross(arm, np.eye(3)["xyz".index(axis[1])])
    assert_close(moment, 0.004 * np.eye(3)["xyz".index(about)], atol=1e-12)


def test_a_moment_about_its_own_force_has_no_arm():
    sizes = (ParameterSize("moment_x_asymmetry", 0.004, 1e-5, "m"),)
    reported = BENCH["load-imbalance"].clause(Claim(cause="load-imbalance", subject="load fx", sizes=sizes))
    assert reported.endswith("between positive and negative load")


@pytest.mark.parametrize(
    ("terms", "words"),
    [
        ({"degree1": (0.0, 0.08), "degree2": (0.01, 1e-4)}, "depends quadratically on the load fz"),
        ({"degree2": (0.01, 1e-4), "degree3": (0.005, 1e-4)}, "depends on the load fz"),
        ({"degree1": (0.05, 0.01), "degree2": (0.01, 1e-4)}, "depends on the load fz"),
    ],
)
def test_an_effect_is_quadratic_if_no_other_term_is_sure(terms, words):
    sizes = tuple(ParameterSize(name, value, sigma, "mV") for name, (value, sigma) in terms.items())
    form = {"columns": ("fz_n",), "half_ranges": (1000.0,), "form": "polynomial", "channel": "v5"}
    reported = FOLLOWED["unexplained"].clause(
        Claim(cause="unexplained", subject="signal v5", sizes=sizes, settings=form)
    )
    assert_says(reported, words)


def first_line(*several) -> tuple[str, str]:
    return build_head("c", bench_tables(rows(*several))).verdicts[0]


OFFSET = {"offset_x": size(5.2, 0.1, "mm"), "offset_y": size(0.05, 0.1, "mm")}
SLIP = {"count": size(-2), "from_step": size(7)}


@pytest.mark.parametrize(
    ("cause", "subject", "parameters", "words"),
    [
        ("load-eccentricity", "load fz", OFFSET, "The z load acts 5.20 ± 0.10 mm off the origin, towards +x"),
        (
            "load-eccentricity",
            "load fz",
            {"offset_x": size(12.03, 0.04, "mm"), "offset_y": size(-7.98, 0.05, "mm")},
            "acts off the origin: 12.030 ± 0.040 mm towards +x and 7.980 ± 0.050 mm towards −y",
        ),
        ("load-eccentricity", "", {"offset_z": size(0.31, 0.02, "mm")}, "The forces act 0.310 ± 0.020 mm off the"),
        (
            "load-eccentricity",
            "load mx",
            {"force_y": size(0.12, 0.01, "1/m")},
            "The torque about x also applies a force: 120 ± 10 N per kN·m towards +y",
        ),
        (
            "load-imbalance",
            "load fz",
            {"moment_y": size(0.004, 0.0001, "m"), "moment_y_asymmetry": size(0.0021, 0.0001, "m")},
            "causes a parasitic moment about y that differs by 2.10 ± 0.10 N·m per kN between positive and "
            "negative load, as if the positive load acted 2.10 ± 0.10 mm further towards −x",
        ),
        (
            "load-imbalance",
            "load fx",
            {"moment_z_asymmetry": size(-0.01, 0.0001, "m")},
            "as if the positive load acted 10.00 ± 0.10 mm further towards +y",
        ),
        (
            "load-imbalance",
            "load mx",
            {
                "share": size(0.002, 0.001),
                "share_asymmetry": size(-0.0153, 0.0005),
                "force_z_asymmetry": size(0.05, 0.002, "1/m"),
            },
            "The first unit takes 1.530 ± 0.050 % of the torque about x less under positive loads than under negative",
        ),
        (
            "load-imbalance",
            "load fz",
            {"share_growth": size(0.0153, 0.0005), "moment_y_growth": size(0.02, 0.001, "m")},
            "takes 1.530 ± 0.050 % of the z load more at the largest load than at small ones",
        ),
        (
            "load-imbalance",
            "load mz",
            {"force_x_growth": size(0.3, 0.04, "1/m")},
            "force along x that grows nonlinearly",
        ),
        (
            "stiffness-scale",
            "load fx",
            {"scale": size(-0.031, 0.002)},
            "is 3.10 ± 0.20 % softer under x loads than sim",
        ),
        ("stiffness-scale", "", {"scale": size(0.031, 0.002)}, "is 3.10 ± 0.20 % stiffer under load than simulated"),
        (
            "stiffness-asymmetry",
            "load my",
            {"asymmetry": size(-0.02, 0.001)},
            "deflects 2.00 ± 0.10 % more under negative torques about y than under positive ones",
        ),
        (
            "stiffness-nonlinear",
            "load fz",
            {"cubic": size(0.02, 0.001)},
            "at the largest load it deflects 2.00 ± 0.10 % more",
        ),
        (
            "hysteresis",
            "load fz",
            {"width": size(0.012, 0.001)},
            "under z loads lags on unloading, by 1.20 ± 0.10 %",
        ),
        ("leg-stiffness", "leg3", {"scale": size(-0.3, 0.01)}, "Leg 3 is 30.0 ± 1.0 % softer than simulated"),
        (
            "play-hysteresis",
            "load fz",
            {"width": size(0.012, 0.001), "threshold": size(0.1, 0.02)},
            "under z loads lags the load and keeps a remainder without load, 1.20 ± 0.10 % of its largest",
        ),
        ("joint-clearance", "load fy", {"clearance": size(3.1, 0.2, "um")}, "jumps by 3.10 ± 0.20 µm when the y load"),
        (
            "creep",
            "load fz",
            {"fraction": size(0.012, 0.001), "tau": size(590.0, 30.0, "s")},
            "by 1.20 ± 0.10 % of its deflection, with a time constant of 9.83 ± 0.50 min",
        ),
        (
            "zero-drift",
            "channel dz",
            {"rate": size(-1.2, 0.1, "um/h")},
            "of channel dz drifts down, by 1.20 ± 0.10 µm/h",
        ),
        (
            "zero-drift",
            "run 4 channel rx",
            {"rate": size(1.2, 0.1, "arcsec/h")},
            "The zero of channel rx in run 4 drifts",
        ),
        (
            "thermal-drift",
            "channel dx",
            {"per_k_material": size(1.2, 0.1, "um/K"), "per_k_air": size(-0.4, 0.1, "um/K")},
            "depends on the temperature of the material by 1.20 ± 0.10 µm/K and the temperature of the air by −0.40",
        ),
        (
            "cosine-error",
            "channel dz",
            {"angle": size(0.0082, 0.0003, "rad")},
            "dz is tilted by 8.20 ± 0.30 mrad from its axis",
        ),
        (
            "cosine-error",
            "channel dz",
            {
                "angle": size(0.0082, 0.0003, "rad"),
                "tilt_dx": size(-0.008, 0.0003, "rad"),
                "tilt_dy": size(0.0001, 0.0003, "rad"),
            },
            "dz is tilted by 8.20 ± 0.30 mrad from its axis: 8.00 ± 0.30 mrad towards −dx",
        ),
        (
            "abbe-offset",
            "channel dz",
            {"arm_x": size(-0.8, 0.1, "mm")},
            "passes off the origin: 0.80 ± 0.10 mm towards −x",
        ),
        (
            "dead-path",
            "",
            {"dead_path": size(152.0, 4.0, "mm")},
            "Every linear channel has a dead path of 152.0 ± 4.0 mm",
        ),
        ("fringe-slip", "run 4", SLIP, "Run 4 counts 2 half wavelengths too few from step 7 on"),
        (
            "fringe-slip",
            "run 4 channel dz",
            {"shift": size(3.3, 0.05, "um"), "from_step": size(7)},
            "The zero of channel dz in run 4 shifts by 3.300 ± 0.050 µm from step 7 on, which is not a whole number",
        ),
        (
            "zero-step",
            "run 4 signal v2",
            {"shift": size(0.2, 0.01, "mV"), "from_step": size(7)},
            "The zero of signal v2 in run 4 shifts by 0.200 ± 0.010 mV from step 7 on",
        ),
        (
            "zero-step",
            "run 4 displacements",
            {"shift_dx": size(0.2, 0.5, "um"), "shift_dz": size(-3.3, 0.5, "um"), "from_step": size(7)},
            "The zeros of all displacements shift together in run 4 from step 7 on, dz by −3.30 ± 0.50 µm",
        ),
        (
            "fringe-slip",
            "run 4 channel dz",
            {"count": size(1)},
            "Channel dz in run 4 counts 1 half wavelength too many",
        ),
        (
            "crosstalk",
            "signal v3",
            {"fraction": size(0.013, 0.001), "source": size("v5")},
            "Signal v3 contains 1.30 ± 0.10 % of signal v5",
        ),
        (
            "signal-nonlinear",
            "signal v3",
            {"quadratic": size(0.0021, 0.0001, "1/mV"), "cubic": size(3e-5, 1e-5, "1/mV^2")},
            "Signal v3 is not linear, with a quadratic part of 0.00210 ± 0.00010 1/mV",
        ),
        (
            "signal-nonlinear",
            "signals",
            {"fx_fx_v1": size(0.02, 0.01, "mV"), "fx_fy_v2": size(-0.3, 0.02, "mV")},
            "signals are not linear: the product fx·fy contributes −0.300 ± 0.020 mV to v2 at the largest loads",
        ),
    ],
)
def test_every_cause_has_its_sentence(cause, subject, parameters, words):
    mark, text = first_line(row(cause, subject=subject, parameters=parameters))
    assert mark == "found"
    assert words in text
    assert_says(text, "runs left out in turn", "34 µm", "7.9 µm", "consistent", "noise (7.2 µm)")
    assert len(text) < 320


def test_components_that_are_not_sure_are_not_reported():
    unsure = {"offset_x": size(0.1, 0.2, "mm"), "offset_y": size(-0.2, 0.15, "mm")}
    text = first_line(row("load-eccentricity", subject="load fz", parameters=unsure))[1]
    assert_says(text, "z load", "0.20 ± 0.15 mm", "towards −y")


def test_exchanged_rows_have_their_own_sentence():
    text = first_line(row("rows-exchanged", subject="run 2", parameters={"rows": size("2/12 2/17")}))[1]
    assert_says(text, "steps 12 and 17", "run 2", "exchanged")


def test_a_noisy_channel_is_named():
    noisy = row("unexplained", subject="channel dy", parameters={"noise_ratio": size(4.3, 0.8)})
    mark, text = first_line(noisy)
    assert mark == "warn"
    assert_says(text, "channel dy", "4.30 ± 0.80 times", "declared noise")
