"""The listing and the figure of the design parameters of flexures."""

from __future__ import annotations

import pandas as pd

from truing.report.calibration.design_parameters import design_parameters, sensitivities


def _tables() -> dict[str, pd.DataFrame]:
    rows = [
        ("beam", 1.0, "beta", "1", 0.25, 0.05, 0.03, 3.7, 26.0, False),
        ("beam", 2.0, "flexure_length", "mm", 10.0, 0.2, 5.0, 3.7, 0.4, True),
        ("stiffness", float("nan"), "flexure_bending", "N m2", 0.09, 0.09, 0.2, 3.7, float("nan"), False),
    ]
    columns = ["model", "leg", "parameter", "unit", "nominal", "tolerance", "sensitivity_um", "closure_noise_um"]
    return {"flexure_parameters": pd.DataFrame(rows, columns=[*columns, "sigma_over_tolerance", "identifiable"])}


def test_every_parameter_has_its_row_with_unit_and_answer() -> None:
    (listing,) = design_parameters(_tables())
    assert [row[1] for row in listing.rows] == ["β of leg 1", "l_b of leg 2", "bending stiffness of the flexures"]
    assert [row[-1] for row in listing.rows] == ["no", "yes", "no"]
    assert listing.rows[1][2:5] == ("10 mm", "0.200 mm", "5 µm")
    assert listing.rows[2][2].startswith("0.0900 N")
    assert listing.rows[2][-2] == "–"
    assert listing.caption.startswith("1 of 3 design parameters")


def test_the_figure_has_effect_and_noise_of_every_parameter() -> None:
    ((figure, words),) = sensitivities(_tables())
    assert [len(trace.x) for trace in figure.data] == [3, 3]
    assert words.startswith("1 of 3")


def test_without_flexures_there_are_no_design_parameters_and_no_sensitivities() -> None:
    assert design_parameters({}) == ()
    assert sensitivities({}) == []
