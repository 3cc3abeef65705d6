"""Faults of campaign.toml itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from tests.broken.spoiling import Broken, appended, cut, gone, replaced, toml, whole
from truing.pipeline.problems import ExitCode

_A1 = "a_mm = [-119.341451, -97.332513, 0.0]"
_B1 = "b_mm = [-14.111343, -134.260456, 0.0]"


def _first(text: str) -> Callable[[Path], None]:
    """A text before all others of campaign.toml."""

    def spoil(folder: Path) -> None:
        file = folder / "campaign.toml"
        file.write_text(text + file.read_text())

    return spoil


def _five_legs(folder: Path) -> None:
    text = (folder / "campaign.toml").read_text()
    last = next(line for line in text.splitlines() if "[-143.963154, -54.686472, 0.0]" in line)
    (folder / "campaign.toml").write_text(text.replace(last + "\n", ""))


def _folder_in_place(folder: Path) -> None:
    (folder / "campaign.toml").unlink()
    (folder / "campaign.toml").mkdir()


def _flat(folder: Path) -> None:
    """Joints of the platform straight above those of the base, legs parallel: the platform may sway and turn freely."""
    text = (folder / "campaign.toml").read_text()
    for line in text.splitlines():
        if "a_mm = [" in line:
            a = line.split("a_mm = ")[1].split(", b_mm")[0]
            text = text.replace(line, line.split("b_mm")[0] + f"b_mm = {a}, u" + line.split(", u", 1)[1])
    (folder / "campaign.toml").write_text(text)


CASES = (
    Broken("toml-absent", "telescope", gone("campaign.toml"), ("campaign.toml",)),
    Broken("toml-a-folder", "telescope", _folder_in_place, ("campaign.toml",)),
    Broken("toml-empty", "telescope", whole("campaign.toml", b""), ("campaign.toml.*campaign",)),
    Broken("toml-truncated", "telescope", cut("campaign.toml", 0.4), (r"campaign\.toml.*valid TOML",)),
    Broken("toml-latin-1", "telescope", whole("campaign.toml", 'name = "Prüfstand"'.encode("latin-1")), ("UTF-8",)),
    Broken("toml-utf-16", "telescope", whole("campaign.toml", 'name = "x"'.encode("utf-16")), ("UTF-8",)),
    Broken("toml-binary", "telescope", whole("campaign.toml", bytes(range(256))), ("campaign.toml",)),
    Broken(
        "toml-key-twice",
        "telescope",
        appended("campaign.toml", "[noise]\npoint_mm = 1.0\n"),
        ("campaign.toml", "noise"),
    ),
    Broken("toml-misspelt-section", "telescope", toml("[noise]", "[nosie]"), ("nosie", "noise")),
    Broken("toml-misspelt-key", "telescope", toml("point_mm", "points_mm"), ("points_mm",)),
    Broken("toml-later-format", "telescope", toml("format = 1", "format = 99"), ("format.*99",)),
    Broken("name-leads-out", "telescope", toml('name = "telescope"', 'name = "../../elsewhere"'), ("name",)),
    Broken("name-empty", "telescope", toml('name = "telescope"', 'name = ""'), ("name",)),
    Broken(
        "kind-unknown", "telescope", toml("photogrammetry", "photography"), ("kind", "photography", "interferometer")
    ),
    Broken("mechanism-unknown", "telescope", toml("6-pus", "7-pus"), ("7-pus", "6-pus")),
    Broken("noise-zero", "telescope", toml("point_mm = 0.005", "point_mm = 0.0"), ("noise.point_mm", "0")),
    Broken("noise-negative", "telescope", toml("point_mm = 0.005", "point_mm = -0.005"), ("noise.point_mm", "-0.005")),
    Broken("noise-nan", "telescope", toml("point_mm = 0.005", "point_mm = nan"), ("noise.point_mm", "nan")),
    Broken("noise-infinite", "telescope", toml("point_mm = 0.005", "point_mm = inf"), ("noise.point_mm", "inf")),
    Broken("noise-as-text", "telescope", toml("point_mm = 0.005", 'point_mm = "5 um"'), ("noise.point_mm", "5 um")),
    Broken("noise-gigantic", "telescope", toml("point_mm = 0.005", "point_mm = 1e300"), ("noise.point_mm", "1e")),
    Broken(
        "noise-tiny", "telescope", toml("point_mm = 0.005", "point_mm = 1e-300"), ("noise.point_mm.*1e-300.*1e-09",)
    ),
    Broken("noise-denormal", "telescope", toml("point_mm = 0.005", "point_mm = 5e-324"), ("noise.point_mm.*5e-324",)),
    Broken("noise-of-readings-tiny", "telescope", toml("actuator_mm = 0.001", "actuator_mm = 1e-300"), ("0, or at",)),
    Broken("tolerance-tiny", "telescope", toml("a_mm = 0.5", "a_mm = 1e-300"), ("tolerance.a_mm.*1e-300",)),
    Broken("key-of-many-dots", "telescope", _first(".".join(["a"] * 20_000) + " = 1\n"), ("64 tables",)),
    Broken("tables-within-tables", "telescope", appended("campaign.toml", f"[{'.'.join(['a'] * 900)}]\n"), ("64",)),
    Broken("quoted-dots", "telescope", appended("campaign.toml", '["a"' + '."a"' * 900 + "]\n"), ("64 tables",)),
    Broken("lists-within-lists", "telescope", appended("campaign.toml", f"z = {'[' * 200}{']' * 200}\n"), ("64",)),
    Broken("tolerance-negative", "telescope", toml("a_mm = 0.5", "a_mm = -0.5"), ("tolerance.a_mm",)),
    Broken(
        "tolerance-longer-than-a-leg",
        "telescope",
        toml("length_mm = 0.5\n", "length_mm = 5000.0\n"),
        ("shortest leg", "tolerance.length_mm", "5000"),
    ),
    Broken(
        "flexures-longer-than-a-leg",
        "telescope",
        toml("flexure_length_mm = 10.0", "flexure_length_mm = 300.0"),
        ("shortest leg", "two flexures of a leg .600."),
    ),
    Broken("tolerance-of-all-directions", "telescope", toml("u = 0.002", "u = 2.0"), ("tolerance.u", "less than 1")),
    Broken(
        "stiffness-wholly-unknown",
        "bench",
        appended("campaign.toml", "[mechanism.tolerance]\nstiffness = 5.0\n"),
        ("stiffness|twice",),
    ),
    Broken("workspace-negative", "telescope", toml("x_mm = 1.0", "x_mm = -1.0"), ("workspace.x_mm",)),
    Broken("five-legs", "telescope", _five_legs, ("legs", "6|six")),
    Broken("leg-of-two-numbers", "telescope", toml(_A1, "a_mm = [-119.341451, -97.332513]"), ("a_mm",)),
    Broken("leg-nan", "telescope", toml(_A1, f"a_mm = [{math.nan}, -97.332513, 0.0]"), ("a_mm", "nan")),
    Broken("leg-gigantic", "telescope", toml(_A1, "a_mm = [1e200, -97.332513, 0.0]"), ("a_mm", "1e")),
    Broken("leg-without-length", "telescope", toml("length_mm = 500.0", "length_mm = 0.0"), ("length_mm",)),
    Broken("leg-without-direction", "telescope", toml("u = [0.0, 0.0, 1.0]", "u = [0.0, 0.0, 0.0]"), ("u",)),
    Broken(
        "legs-alike",
        "telescope",
        toml("a_mm = [119.341451, -97.332513, 0.0], b_mm = [14.111343, -134.260456, 0.0]", f"{_A1}, {_B1}"),
        ("attachment-labels target A2",),
        ExitCode.FAILED_CHECK,
    ),
    Broken("legs-parallel", "telescope", _flat, ("legs-regular",), ExitCode.FAILED_CHECK, whole=True),
    Broken(
        "leg-cannot-reach",
        "telescope",
        toml("length_mm = 500.0", "length_mm = 50.0"),
        ("readings-against-poses",),
        ExitCode.FAILED_CHECK,
        whole=True,
    ),
    Broken(
        "file-not-there",
        "telescope",
        appended("campaign.toml", '[files.points]\npath = "export.csv"\n'),
        ("export.csv",),
    ),
    Broken(
        "pattern-matches-nothing",
        "telescope",
        appended("campaign.toml", '[files.points]\npath = "export_*.csv"\n'),
        (r"export_\*\.csv",),
    ),
    Broken(
        "pattern-broken",
        "telescope",
        appended("campaign.toml", '[files.points]\npath = "points.csv"\nfrom_name = "(?P<pose"\n'),
        ("from_name",),
    ),
    Broken(
        "column-not-there",
        "telescope",
        appended("campaign.toml", '[files.points]\npath = "points.csv"\ncolumns = { x_mm = "X" }\n'),
        ("x_mm", "X"),
    ),
    Broken(
        "unit-unknown",
        "telescope",
        appended("campaign.toml", '[files.points]\npath = "points.csv"\nunits = { x_mm = "furlong" }\n'),
        ("furlong",),
    ),
    Broken(
        "wavelength-zero",
        "bench",
        replaced("campaign.toml", "wavelength_nm = 632.990577", "wavelength_nm = 0.0"),
        ("wavelength_nm",),
    ),
    Broken(
        "elements-too-long",
        "bench",
        replaced("campaign.toml", '{ kind = "rigid" }', '{ kind = "rigid", length_mm = 4000.0 }'),
        ("element|length",),
    ),
    Broken("element-unknown", "bench", replaced("campaign.toml", 'kind = "spring"', 'kind = "rubber"'), ("rubber",)),
    Broken(
        "compliance-lopsided",
        "bench",
        replaced("campaign.toml", "[6.432818507e-09,0.000000000e+00", "[6.432818507e-09,1.000000000e-09"),
        ("symmetric",),
    ),
    Broken(
        "compliance-negative",
        "bench",
        replaced("campaign.toml", "[[6.432818507e-09", "[[-6.432818507e-09"),
        ("elements.*negative eigenvalue",),
    ),
)
