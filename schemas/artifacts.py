"""Every artifact of a run, by name."""

from __future__ import annotations

from schemas.artifact import Artifact
from schemas.calibration_artifacts import CALIBRATION
from schemas.diagnosis_artifacts import DIAGNOSIS
from schemas.measurement_artifacts import MEASUREMENT
from schemas.photograph_artifacts import PHOTOGRAPHS

ARTIFACTS: dict[str, Artifact] = {
    artifact.name: artifact for artifact in (*MEASUREMENT, *PHOTOGRAPHS, *CALIBRATION, *DIAGNOSIS)
}
