"""What predictions are held against, in words: points of poses, or readings of load steps."""

from __future__ import annotations

from dataclasses import dataclass

from truing.report.load_steps import is_bench
from truing.report.tables import Tables


@dataclass(frozen=True)
class Compared:
    """How the parts of a campaign are named: what is held out as a whole, what of it was fitted to and what was not.

    ``built``: what has a tolerance, with the question whether it keeps that, and the answer that it does.
    """

    whole: str
    fitted: str
    held_out: str
    held_out_errors: str
    fitted_or_not: str
    not_planned: str
    built: str
    built_question: str
    as_built: str


POINTS = Compared(
    "pose",
    "calibration poses",
    "held-out poses",
    "verification errors",
    "Calibration poses were fitted to, held-out poses were not.",
    "No configurations were computed: nothing was found or left open that poses of this mechanism settle.",
    "geometry",
    "does the geometry return to where it was built?",
    "The geometry is where it was built.",
)
READINGS = Compared(
    "run",
    "fitted runs",
    "held-out runs",
    "held-out errors",
    "Held-out runs are predicted by a fit that has not seen them.",
    "No loads were computed: nothing was found or left open that loads on this bench settle.",
    "lengths and stiffnesses",
    "is the sensor what it was built to be?",
    "Lengths and stiffnesses are what they were built to be.",
)
AXIS = Compared(
    "row",
    "fitted rows",
    "held-out rows",
    "held-out errors",
    "Held-out rows are predicted by a fit that has not seen them.",
    "No commands were computed: what each finding asks for is said in words.",
    "encoders",
    "are the encoders what they were built to be?",
    "The encoders are what they were built to be.",
)


def compared(tables: Tables) -> Compared:
    """The words for a campaign's kind."""
    if "axis_errors" in tables:
        return AXIS
    return READINGS if is_bench(tables) else POINTS
