"""Reasons why a section of the page is empty, judged by the tables."""

from __future__ import annotations

import re

from truing.report.tables import Tables, is_bench, is_single_axis, reason, table_or_none
from truing.schemas.columns import COLUMNS

_READING = re.compile(r"_(mm|um|deg|rad|mrad|arcsec|counts)$")


def why_no_quality(tables: Tables) -> str:
    """Return the reason why nothing was checked."""
    if text := reason(tables, "qa"):
        return text
    quantities = "readings or signals of load steps" if is_bench(tables) else "object points"
    return f"The campaign holds no {quantities}."


def why_no_diagnosis(tables: Tables) -> str:
    """Return the reason why no cause was assessed."""
    if text := reason(tables, "diagnosis"):
        return text
    if is_bench(tables):
        return "too little was read under load, or no model says how the sensor should respond to loads."
    if not _has_readings(tables):
        return "without a mechanism and its actuator readings, no simulation can be compared with the points."
    return "the catalogue has no cause for this mechanism yet, or too little was measured."


def why_no_deformation(tables: Tables) -> str:
    """Return the reason why no deformation was modelled."""
    if is_single_axis(tables):  # its stage has the positioning, and gives the reason for that
        return "An axis has rows of readings, and no bodies with targets."
    if text := reason(tables, "deformation"):
        return text
    if is_bench(tables):
        return "How the platform moves under load was not measured, or not in a way that can be used."
    if not _has_readings(tables):
        return "No input for a deformation: no actuator readings, and no drives named in [campaign]."
    return "No target sits at an attachment, or too few of them were seen."


def recorded_readings(tables: Tables) -> list[str]:
    """Return the columns of the configurations with lengths or angles, as readings of drives and joints."""
    configurations = table_or_none(tables, "configurations")
    return [] if configurations is None else [str(c) for c in configurations.columns if _READING.search(str(c))]


def _has_readings(tables: Tables) -> bool:
    readings = table_or_none(tables, "configurations")
    return readings is not None and any(COLUMNS["rho"].matches(str(column)) for column in readings.columns)


def why_no_calibration(tables: Tables) -> str:
    """Return the reason why no model was calibrated."""
    if text := reason(tables, "calibration"):
        return text
    if not _has_readings(tables):
        return "Nothing to calibrate: no mechanism with actuator readings."
    poses = table_or_none(tables, "poses")
    if poses is None or not (poses["body"] == "platform").any():
        return "No pose of the platform was measured that a model could be fitted to."
    return "No model of this mechanism could be fitted: too few poses with readings, or too few targets."


def why_not_known(tables: Tables) -> str:
    """Return the reason why observability was not computed."""
    return (
        why_no_calibration(tables)
        if table_or_none(tables, "calibration") is None
        else "No calibration recorded its observability."
    )


def why_no_requirement(tables: Tables) -> str:
    """Return the reason why no requirement was assessed."""
    if table_or_none(tables, "requirements") is not None:
        return "Nothing was measured that shows the error in a component of [requirement]."
    if is_by_components(tables):
        return "campaign.toml states no accuracy in [requirement]."
    if table_or_none(tables, "calibration") is None:
        return why_no_calibration(tables)
    if table_or_none(tables, "accuracy") is None:
        return "Accuracy cannot be assessed without pose errors: fewer than six legs do not constrain the platform."
    return "campaign.toml states no accuracy in [requirement]."


def is_by_components(tables: Tables) -> bool:
    """Return True for a machine that the diagnosis alone identifies: an open chain, or a single axis."""
    return any(table_or_none(tables, name) is not None for name in ("joints", "axis_errors"))


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
    """Return the reason why the table of a section is missing."""
    if section == "requirements" and (is_bench(tables) or "displacement" in tables):
        if table_or_none(tables, "sensor_choice") is None:
            return "the sensor was not calibrated, so no error of its loads is known."
        return "campaign.toml states no accuracy of loads in [requirement] (fx_n to mz_nm)."
    if section == "displacement":
        return "This run holds no readings of how the platform moved."
    return f"This run holds no table of stage {_STAGES[section]}: the stage was not run, or the run stopped before it."
