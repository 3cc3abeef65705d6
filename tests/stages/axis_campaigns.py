"""Campaigns of one rotary axis with lost motion and a shifted zero, for the tests of its stages."""

from __future__ import annotations

import numpy as np
from typer.testing import CliRunner

from tests.blind.generator.axis import AxisCampaign, AxisLayout, Hidden, record
from truing.pipeline.command_line import app

BACKLASH, SHIFT, EVENT_ROW = 0.012, 0.02, 26
HIDDEN = (Hidden("lost-motion", "", BACKLASH), Hidden("zero-shift", "instrument", SHIFT, EVENT_ROW, True))


def axis_layout(**changes: object) -> AxisLayout:
    sweep = np.linspace(-80.0, 80.0, 10)
    given = {
        "kind": "rotary",
        "loop": "motor",
        "channels": ("motor", "load", "measured"),
        "command": np.concatenate([sweep, sweep[::-1], sweep, sweep[::-1]]),
        "noise": {"command": 1e-3, "motor": 3e-4, "load": 1e-3, "measured": 1e-3},
        "event_row": EVENT_ROW,
        "held_out": np.arange(40) % 5 == 3,
    }
    return AxisLayout(**(given | changes))  # type: ignore[arg-type]


def axis_campaign() -> AxisCampaign:
    return record(axis_layout(), HIDDEN, np.random.default_rng(5))


def truing_command(*arguments: str) -> tuple[int, str]:
    """Exit code and all that was said."""
    done = CliRunner().invoke(app, list(arguments))
    return done.exit_code, done.output
