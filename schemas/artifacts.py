"""Every artifact of a run, by name."""

from __future__ import annotations

from schemas.artifact import Artifact
from schemas.calibration_artifacts import CALIBRATION
from schemas.diagnosis_artifacts import DIAGNOSIS
from schemas.measurement_artifacts import MEASUREMENT

ARTIFACTS: dict[str, Artifact] = {artifact.name: artifact for artifact in (*MEASUREMENT, *CALIBRATION, *DIAGNOSIS)}
