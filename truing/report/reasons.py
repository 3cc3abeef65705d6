"""Why a part of the page is empty, as far as the tables tell."""

from __future__ import annotations

import re

from truing.report.tables import Tables, filled, is_bench, reason
from truing.schemas.columns import COLUMNS

_READING = re.compile(r"_(mm|um|deg|rad|mrad|arcsec|counts)$")


def why_no_quality(tables: Tables) -> str:
    """Why nothing was checked."""
    if text := reason(tables, "qa"):
        return text
    what = "readings or signals of load steps" if is_bench(tables) else "object points"
    return f"The campaign holds no {what}."


def why_no_diagnosis(tables: Tables) -> str:
    """Why no cause was judged."""
    if text := reason(tables, "diagnosis"):
        return text
    if is_bench(tables):
        return "too little was read under load, or no model says how the sensor should respond to loads."
    if not _has_readings(tables):
        return "without a mechanism and its actuator readings, no simulation can be compared with the points."
    return "the catalogue has no cause for this mechanism yet, or too little was measured."


def why_no_deformation(tables: Tables) -> str:
    """Why no deformation was modelled."""
    if text := reason(tables, "deformation"):
        return text
    if is_bench(tables):
        return "How the platform moves under load was not measured, or not in a way that can be used."
    if not _has_readings(tables):
        return "No input for a deformation: no actuator readings, and no drives named in [campaign]."
    return "No target sits at an attachment, or too few of them were seen."


def recorded_readings(tables: Tables) -> list[str]:
    """The columns of the configurations that hold lengths or angles, as readings of drives and joints do."""
    configurations = filled(tables, "configurations")
    return [] if configurations is None else [str(c) for c in configurations.columns if _READING.search(str(c))]


def _has_readings(tables: Tables) -> bool:
    readings = filled(tables, "configurations")
    return readings is not None and any(COLUMNS["rho"].matches(str(column)) for column in readings.columns)


def why_no_calibration(tables: Tables) -> str:
    """Why no model was calibrated."""
    if text := reason(tables, "calibration"):
        return text
    if not _has_readings(tables):
        return "Nothing to calibrate: no mechanism with actuator readings."
    poses = filled(tables, "poses")
    if poses is None or not (poses["body"] == "platform").any():
        return "No pose of the platform was measured that a model could be fitted to."
    return "No model of this mechanism could be fitted: too few poses with readings, or too few targets."


def why_not_known(tables: Tables) -> str:
    """Why nothing is said of what can be known."""
    return (
        why_no_calibration(tables)
        if filled(tables, "calibration") is None
        else "No calibration recorded its observability."
    )


def why_no_requirement(tables: Tables) -> str:
    """Why no requirement was judged."""
    if filled(tables, "calibration") is None:
        return why_no_calibration(tables)
    if filled(tables, "accuracy") is None:
        return "Accuracy cannot be assessed without pose errors: fewer than six legs do not constrain the platform."
    return "campaign.toml states no accuracy in [requirement]."


_STAGES = {
    "diagnosis": "diagnose",
    "qa": "qa",
    "poses": "pose",
    "deformation": "deformation",
    "calibration": "calibrate",
    "requirements": "calibrate",
    "uncertainty": "uncertainty",
}


def why_absent(section: str, tables: Tables) -> str:
    """Why there is no table that a section could be made of."""
    if section == "requirements" and (is_bench(tables) or "displacement" in tables):
        return "[requirement] applies to positioning mechanisms; for errors of a sensor, see Calibration."
    if section == "displacement":
        return "This run holds no readings of how the platform moved."
    return f"This run holds no table of stage {_STAGES[section]}: the stage was not run, or the run stopped before it."
