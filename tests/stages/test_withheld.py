"""A failed consistency check withholds the results that depend on it; an ordinary failure does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.schedule import published_moves
from tests.stages.line import run_line
from truing.report.page_head import build_head
from truing.schemas.campaign import read_campaign
from truing.schemas.quality_checks import CHECKS, WITHHOLDING
from truing.stages import calibrate, deformation, diagnose, pose
from truing.stages.common.belonging import reason_withheld
from truing.stages.declaration import Outcome

OF_MODELS = (deformation, diagnose, calibrate)
CAMPAIGN = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}})
OBSERVATIONS = pa.table({"pose": [0], "body": ["platform"], "target": ["A"]})


def _qa(check: str, verdict: str = "fail", accepted: str | None = None) -> dict[str, pa.Table]:
    row = {"check": check, "subject": "", "verdict": verdict, "message": "found.", "accepted": accepted}
    return {"qa": pa.Table.from_pylist([row], schema=pa.schema([(name, pa.string()) for name in row]))}


def _outcome(stage: object, tables: dict[str, pa.Table]) -> Outcome:
    return stage.run({**tables, "observations": OBSERVATIONS}, CAMPAIGN, lambda *_: None)  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", WITHHOLDING)
def test_a_check_that_withholds_stops_every_stage_that_rests_on_it(name: str) -> None:
    for stage in (*OF_MODELS, *([pose] if WITHHOLDING[name].withholds == "poses" else [])):
        said = _outcome(stage, _qa(name))
        assert name in said.why_not
        assert not any(table.num_rows for table in said.artifacts.values())
    assert not reason_withheld(_qa(name, "warn"))
    assert not reason_withheld(_qa(name, accepted="M. Keller: known"))


def test_labels_units_and_scale_withhold_and_ordinary_failures_do_not() -> None:
    assert {"attachment-labels", "scale", "target-sizes", "temperature-unit", "surroundings"} <= set(WITHHOLDING)
    for ordinary in ("noise", "completeness", "gross-errors", "exchanged-labels", "bar-lengths", "repeatability"):
        assert not reason_withheld(_qa(ordinary))
    shared = [name for name in CHECKS["photogrammetry"] if name in CHECKS["interferometer"]]
    for name in shared:
        one, other = (CHECKS[kind][name].withholds for kind in ("photogrammetry", "interferometer"))
        assert one == other


def test_attachments_under_exchanged_legs_are_not_calibrated_until_a_person_accepts(tmp_path: Path) -> None:
    layout = Layout(name="plain", targets=Targets(per_leg=0))
    drawn = draw_campaign(layout, published_moves(), [], np.random.default_rng(1))
    folder = write_campaign(drawn, tmp_path / "c", 1)
    survey = pd.read_csv(folder / "targets.csv")
    survey["leg"] = survey["leg"].replace({1: 2, 2: 1}).astype("Int64")
    survey.to_csv(folder / "targets.csv", index=False)
    made, said = run_line(folder, "ingest", "qa", "pose", "deformation", "diagnose", "calibrate")
    assert [name.split()[0] for name in said["qa"].failed_checks] == ["attachment-labels", "attachment-labels"]
    assert made["poses"].num_rows
    for name in ("deformation", "diagnosis", "calibration"):
        assert not made[name].num_rows
    first = build_head("c", {name: made[name].to_pandas() for name in ("qa", "diagnosis", "poses")}).verdicts[0]
    assert first[0] == "fail"
    assert "attachment-labels" in first[1]
    assert "Correct leg in targets.csv" in first[1]
    accept = "".join(
        f'\n[[accept]]\ncheck = "attachment-labels"\nsubject = "{name.partition(" ")[2]}"\n'
        'by = "M. Keller"\nreason = "known"\n'
        for name in said["qa"].failed_checks
    )
    with (folder / "campaign.toml").open("a", encoding="utf-8") as file:
        file.write(accept)
    again, _ = run_line(folder, "ingest", "qa", "pose", "deformation")
    assert again["deformation"].num_rows
