"""Broken campaigns with wrong units, or with values that refer to nothing."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.broken.spoiling import Broken, Spoil, appended, both, cells, every, toml
from truing.pipeline.problems import ExitCode

_LOG, _POSES, _TEMPERATURE = "interferometer.csv", "configurations.csv", "temperature_c"
_REFERENCE = "reference_temperature_c = 20.0"


def _turned(change: Callable[[float], float]) -> Callable[[str], str]:
    return lambda text: repr(change(float(text)))


def _compliance(matrix: np.ndarray) -> Spoil:
    """The simulated compliance in a file, in place of elements."""

    def spoil(folder: Path) -> None:
        text = (folder / "campaign.toml").read_text(encoding="utf-8")
        text, count = re.subn(r"elements = \[.*?\n\]", 'compliance_file = "compliance.csv"', text, flags=re.DOTALL)
        assert count == 1
        (folder / "campaign.toml").write_text(text, encoding="utf-8")
        rows = "".join(",".join(f"{value:.9e}" for value in row) + "\n" for row in matrix)
        (folder / "compliance.csv").write_text(rows, encoding="utf-8")

    return spoil


def _with_role(file: str) -> Spoil:
    """A column of roles in which every run is a reference."""

    def spoil(folder: Path) -> None:
        head, *lines = (folder / file).read_text(encoding="utf-8").splitlines()
        text = "".join(f"{line}\n" for line in (f"{head},role", *(f"{line},reference" for line in lines)))
        (folder / file).write_text(text, encoding="utf-8")

    return spoil


_DIAGONAL = np.diag([2e-7, 2e-7, 3e-8, 4e-7, 4e-7, 3e-7])  # m/N and rad/(N m), the bench's to a digit
_SINGULAR = _DIAGONAL.copy()
_SINGULAR[0, 4] = _SINGULAR[4, 0] = np.sqrt(_DIAGONAL[0, 0] * _DIAGONAL[4, 4])
_NO_TORSION = _DIAGONAL * (np.arange(6) < 5)
_ACCEPT = '\n[[accept]]\ncheck = "{}"\nsubject = "{}"\nby = "A. Lab"\nreason = "known"\n'

CASES = (
    Broken("number-as-flag", "telescope", toml("point_mm = 0.005", "point_mm = true"), ("noise.point_mm.*true",)),
    Broken("number-in-quotes", "telescope", toml("point_mm = 0.005", 'point_mm = "0.005"'), ("noise.point_mm.*0.005",)),
    Broken(
        "name-with-nul",
        "telescope",
        appended("campaign.toml", '\n[[exclude]]\ntarget = "P\\u00007"\nby = "A"\nreason = "x"\n'),
        ("exclude.1.target", r"control characters; it contains U\+0000"),
    ),
    Broken(
        "reference-below-absolute-zero",
        "telescope",
        toml(_REFERENCE, "reference_temperature_c = -300.0"),
        ("mechanism.reference_temperature_c", "at least -273.15"),
    ),
    Broken(
        "reference-in-kelvin",
        "telescope",
        toml(_REFERENCE, "reference_temperature_c = 293.15"),
        ("temperature-unit temperature_c",),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "reference-in-fahrenheit",
        "telescope",
        toml(_REFERENCE, "reference_temperature_c = 68.0"),
        ("temperature-unit temperature_c",),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "temperature-in-kelvin",
        "telescope",
        cells(_POSES, _TEMPERATURE, _turned(lambda c: c + 273.15), every),
        ("temperature-unit temperature_c",),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "temperature-in-fahrenheit",
        "telescope",
        cells(_POSES, _TEMPERATURE, _turned(lambda c: 1.8 * c + 32.0), every),
        ("temperature-unit temperature_c",),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "pressure-in-pascals",
        "bench",
        cells(_LOG, "air_pressure_hpa", _turned(lambda p: 100.0 * p), every),
        ("surroundings air pressure",),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "accepted-check-unknown",
        "telescope",
        appended("campaign.toml", _ACCEPT.format("exchanged-lables", "")),
        ("accept.1.subject",),
    ),
    Broken(
        "accepted-check-misspelt",
        "telescope",
        appended("campaign.toml", _ACCEPT.format("exchanged-lables", "targets P02 P05")),
        ("accept.1.check.*exchanged-lables", "did you mean exchanged-labels"),
    ),
    Broken(
        "accepted-check-of-a-bench",
        "telescope",
        appended("campaign.toml", _ACCEPT.format("fringes-counted", "run 1")),
        ("accept.1.check.*fringes-counted", "kind photogrammetry"),
    ),
    Broken(
        "every-pose-a-reference",
        "telescope",
        cells(_POSES, "role", lambda _: "reference", every),
        ("configurations.csv, column role.*reference alone", "role calibration"),
    ),
    Broken(
        "every-run-a-reference",
        "bench",
        both(_with_role(_LOG), _with_role("signals.csv")),
        ("interferometer.csv, column role.*reference alone", "at least one run of role calibration"),
    ),
    Broken("compliance-zero", "bench", _compliance(0.0 * _DIAGONAL), ("compliance_file.*compliance under fx_n, fy_n",)),
    Broken("compliance-rigid-about-z", "bench", _compliance(_NO_TORSION), ("compliance_file.*compliance under mz_nm",)),
    Broken("compliance-singular", "bench", _compliance(_SINGULAR), ("compliance_file.*singular",)),
    Broken(
        "compliance-a-stiffness",
        "bench",
        _compliance(np.diag(1.0 / np.diag(_DIAGONAL))),
        ("compliance_file.*is it the stiffness",),
    ),
    Broken(
        "compliance-in-mm-per-newton",
        "bench",
        _compliance(_DIAGONAL * np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])),
        ("compliance_file.*1.8 m under fx_n = 9000", "in mm"),
    ),
    Broken(
        "compliance-of-another-sensor",
        "bench",
        _compliance(_DIAGONAL * 50.0),
        ("units run 1 dx",),
        ExitCode.FAILED_CHECK,
    ),
)
