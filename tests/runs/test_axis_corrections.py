"""Corrections of an axis, added to the commands, cancel the errors of the modelled machine."""

from __future__ import annotations

import csv
import io

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_close
from truing.runs.exports.axis_corrections import axis_corrections
from truing.simulation.axis.extended_model import ExtendedAxis, read_axis

LOST, SCALE = 4e-6, 12e-6  # m, 1
MODEL = """
format = 2
[model]
campaign = "axis"
mechanism = "axis"
kind = "linear"
loop = "{loop}"
least_move = {least}
encoders = [{encoders}]
[zeros]
{zeros}
[[effects]]
cause = "lost-motion"
subject = ""
settings = {{ kind_of_axis = "linear", plausible = 1e-5 }}
values = [4e-6]
parameters = {{}}
[[effects]]
cause = "scale-error"
subject = "axis"
settings = {{ kind_of_axis = "linear", plausible = 1e-5, element = "axis" }}
values = [12e-6]
parameters = {{}}
{growth}[covariance]
names = [{names}]
rows = [{rows}]
"""

GROWTH = """[[effects]]
cause = "axis-growth"
subject = "axis"
settings = { kind_of_axis = "linear", plausible = 1e-5, element = "axis", column = "temperature_c", reference_c = 20.0 }
values = [1e-5]
parameters = {}
"""


def model_of(
    least: float = 1e-6, loop: str = "motor", encoders: tuple[str, ...] = ("measured",), *, grows: bool = False
) -> ExtendedAxis:
    """An axis with lost motion and a scale error, whose unknowns are independent, each with a sigma of 1e-7."""
    names = (*encoders, "backlash", "scale", *(("growth",) if grows else ()))
    return read_axis(
        MODEL.format(
            loop=loop,
            least=least,
            encoders=", ".join(f'"{name}"' for name in encoders),
            zeros="\n".join(f"{name} = 5e-5" for name in encoders),
            growth=GROWTH if grows else "",
            names=", ".join(f'"{name}"' for name in names),
            rows=", ".join(str([0.0] * k + [1e-14]) for k in range(len(names))),
        )
    )


def table_of(model: ExtendedAxis, commands_mm: NDArray, caution: str = "") -> pd.DataFrame | None:
    errors = pd.DataFrame({"command": commands_mm})
    files = dict(axis_corrections(model, {"axis_errors": errors}, caution))
    return pd.read_csv(io.BytesIO(files["axis_corrections.csv"])) if files else None


def stands_at_mm(command_mm: NDArray, approach: float) -> NDArray:
    """Position of the axis as the catalogue defines it: behind by the backlash, and (1 + scale) times as far."""
    return command_mm - approach * 1e3 * LOST + SCALE * command_mm


def test_a_corrected_command_brings_the_axis_to_where_it_was_sent() -> None:
    commands = np.array([-100.0, -40.0, 10.0, 60.0, 100.0])
    table = table_of(model_of(), commands)
    assert table is not None
    assert_close(table["command_mm"].to_numpy(), commands, atol=1e-9)
    origin = stands_at_mm(np.array([10.0]), 1.0) - 10.0  # nearest to zero, from below
    for side, approach in (("from_below", 1.0), ("from_above", -1.0)):
        corrected = commands + 1e-3 * table[f"{side}_um"].to_numpy()
        # scale of a correction of microns: below a tenth of a nanometre
        assert_close(stands_at_mm(corrected, approach) - origin, commands, atol=1e-6, what=side)


def test_uncertainties_are_those_of_the_difference_to_the_origin() -> None:
    commands = np.array([0.0, 100.0])
    table = table_of(model_of(), commands)
    assert table is not None
    assert_close(table["sigma_from_below_um"].to_numpy(), 0.1 * np.array([0.0, 0.1]), atol=1e-6)
    assert_close(table["sigma_from_above_um"].to_numpy(), 0.1 * np.hypot(2.0, [0.0, 0.1]), atol=1e-6)


def test_effects_of_a_temperature_are_no_part_of_a_table_over_the_command() -> None:
    commands = np.array([0.0, 100.0])
    pd.testing.assert_frame_equal(table_of(model_of(grows=True), commands), table_of(model_of(), commands))


def test_a_recording_of_many_commands_gets_targets_over_its_travel() -> None:
    table = table_of(model_of(least=0.5e-3), np.linspace(0.0, 50.0, 5000))
    assert table is not None
    steps = np.diff(table["command_mm"].to_numpy())
    assert 2 <= len(table) <= 101
    assert steps.min() >= 1.0 - 1e-9  # twice the least move: each target has a direction of approach
    assert_close(table["command_mm"].iloc[[0, -1]].to_numpy(), np.array([0.0, 50.0]), atol=1e-9)


def test_without_an_encoder_outside_the_loop_there_is_nothing_to_correct() -> None:
    assert table_of(model_of(loop="motor", encoders=("motor",)), np.arange(5.0)) is None
    assert table_of(model_of(loop="load", encoders=("load",)), np.arange(5.0)) is None


@pytest.mark.parametrize("caution", ["", "inadequate"])
def test_each_row_carries_the_caution(caution: str) -> None:
    files = dict(axis_corrections(model_of(), {"axis_errors": pd.DataFrame({"command": [0.0, 1.0]})}, caution))
    rows = list(csv.DictReader(io.StringIO(files["axis_corrections.csv"].decode())))
    assert [row["caution"] for row in rows] == [caution, caution]
