"""Exchanged columns of motor and load encoder are recognised by agreement with instrument and command."""

from __future__ import annotations

import numpy as np
import pytest

from truing.stages.common.axis_columns import AxisColumns
from truing.stages.quality.axis_checks import encoders_in_place

NAMES = ("motor", "load", "measured")
NOISE, ROWS = 1e-5, 40


def _verdict(loop: str, of_motor: float, of_load: float, errs: float = 0.0, *, exchanged: bool = False) -> str:
    """Motor and load depart from the command by waves of these sizes, and the reading of the load ``errs`` too."""
    rng = np.random.default_rng(3)
    wave, other = np.sin(np.arange(ROWS)), np.cos(3.0 * np.arange(ROWS))
    read = [of_motor * wave, of_load * wave + errs * other, of_load * wave]
    found = dict(zip(NAMES, np.array(read) + rng.normal(scale=NOISE, size=(3, ROWS)), strict=True))
    if exchanged:
        found["motor"], found["load"] = found["load"], found["motor"]
    columns = AxisColumns("rotary", "deg", loop, "command_deg", {name: f"{name}_deg" for name in NAMES}, None)
    return encoders_in_place(columns, found).verdict


@pytest.mark.parametrize(("loop", "of_motor", "of_load"), [("motor", 0.0, 5e-5), ("load", 5e-5, 0.0)])
def test_exchanged_columns_are_reported_and_right_ones_are_not(loop: str, of_motor: float, of_load: float) -> None:
    assert _verdict(loop, of_motor, of_load) == "pass"
    assert _verdict(loop, of_motor, of_load, exchanged=True) == "fail"


def test_an_instrument_that_follows_the_command_closer_than_the_loop_is_in_its_column() -> None:
    rng, wave = np.random.default_rng(4), np.sin(np.arange(ROWS))
    read = np.array([0.0 * wave, 5e-5 * wave, 5e-5 * wave]) + rng.normal(scale=NOISE, size=(3, ROWS))
    right = dict(zip(NAMES, read, strict=True))
    columns = AxisColumns("rotary", "deg", "motor", "command_deg", {name: f"{name}_deg" for name in NAMES}, None)
    noise = dict.fromkeys(NAMES, NOISE)
    assert encoders_in_place(columns, right, noise).verdict == "pass"
    slipped = right | {"motor": right["measured"], "measured": right["motor"]}
    found = encoders_in_place(columns, slipped, noise)
    assert (found.verdict, "columns motor_deg and measured_deg" in found.message) == ("fail", True)
    following = 5e-5 * np.cos(3.0 * np.arange(ROWS))  # of the controller: all encoders see it
    assert encoders_in_place(columns, {name: each + following for name, each in right.items()}, noise).verdict == "pass"


def test_an_error_of_the_load_encoder_is_no_exchange_and_neither_is_noise() -> None:
    assert _verdict("motor", 0.0, 0.0, errs=5e-5) == "pass"
    assert _verdict("motor", 0.0, 0.0, exchanged=True) == "pass"


@pytest.mark.parametrize(
    ("loop", "wave", "noise", "verdict"),
    [
        ("motor", 5e-5, 1e-5, "fail"),  # the screw's error shows in the encoder that the controller is said to hold
        ("load", 5e-5, 1e-5, "pass"),
        ("motor", 5e-5, 4e-5, "pass"),  # no farther than its noise
        ("motor", 0.0, 1e-5, "pass"),
    ],
)
def test_without_an_instrument_the_command_is_followed_by_the_encoder_of_the_loop(
    loop: str, wave: float, noise: float, verdict: str
) -> None:
    rng = np.random.default_rng(5)
    read = np.array([wave * np.sin(np.arange(ROWS)), np.zeros(ROWS)]) + rng.normal(scale=NOISE, size=(2, ROWS))
    columns = AxisColumns("linear", "mm", loop, "command_mm", {"motor": "motor_mm", "load": "load_mm"}, None)
    found = encoders_in_place(columns, dict(zip(NAMES, read, strict=False)), {"motor": noise, "load": noise})
    assert found.verdict == verdict
    assert ('loop = "load"' in found.message) == (verdict == "fail")


def test_one_encoder_is_not_evaluated() -> None:
    columns = AxisColumns("rotary", "deg", "motor", "command_deg", {"motor": "motor_deg"}, None)
    assert encoders_in_place(columns, {"motor": np.zeros(ROWS)}).verdict == "not evaluated"
