"""Definitions of all artifacts of a run, by name."""

from __future__ import annotations

from truing.schemas.artifact import Artifact
from truing.schemas.calibration_artifacts import CALIBRATION
from truing.schemas.diagnosis_artifacts import DIAGNOSIS
from truing.schemas.measured_artifacts import MEASUREMENT
from truing.schemas.photograph_artifacts import PHOTOGRAPHS

ARTIFACTS: dict[str, Artifact] = {
    artifact.name: artifact for artifact in (*MEASUREMENT, *PHOTOGRAPHS, *CALIBRATION, *DIAGNOSIS)
}
