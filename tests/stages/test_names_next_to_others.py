"""A name that rivals contest before other causes are known is reported with certainty once these are in the model."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

SAMPLE = Path(__file__).parents[2] / "sample_data" / "robot"


@pytest.mark.slow
def test_both_hidden_effects_of_the_sample_robot_are_found(robot_run: Path) -> None:
    """Until the eccentricity of the elbow is known, the upper arm may bend, where the shoulder is compliant."""
    hidden = json.loads(SAMPLE.with_name("robot.truth.json").read_text(encoding="utf-8"))["effects"]
    rows = pd.read_parquet(robot_run / "run" / "diagnosis.parquet")
    found = rows[rows["verdict"] == "found"]
    assert set(zip(found["cause"], found["subject"], strict=True)) == {(e["cause"], e["subject"]) for e in hidden}
    assert (found["probability"] > 0.99).all()
    assert not (rows["verdict"] == "indistinguishable").any(), "a rival within odds of 20 before the elbow was known"
