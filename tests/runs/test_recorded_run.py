"""A run opened again is the run: its tables, the sentences and figures of its page, its model."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import truing
from truing.schemas.artifacts import ARTIFACTS


@pytest.fixture(scope="module")
def run(workplace: Path) -> truing.Run:
    return truing.load(workplace / "runs" / "telescope")


def test_every_table_of_the_folder_is_there_with_units_and_origin(run: truing.Run, workplace: Path) -> None:
    files = {path.name for path in (workplace / "runs" / "telescope").glob("*.parquet")}
    assert {ARTIFACTS[name].file for name in run} == files
    poses = run["poses"]
    assert poses.attrs["units"]["px_mm"] == "mm"
    assert poses.attrs["stage"] == "pose"
    assert poses.equals(pq.read_table(run.files["poses"]).to_pandas())


def test_a_table_is_a_copy(run: truing.Run) -> None:
    poses = run["poses"]
    poses["px_mm"] = 0.0
    assert (run["poses"]["px_mm"] != 0.0).any()


def test_sentences_and_figures_are_those_of_the_page(run: truing.Run) -> None:
    page = (run.folder / "report.html").read_text(encoding="utf-8")
    plain = re.sub(r"\s+", " ", page)
    assert run.verdicts
    assert all(sentence.replace("&", "&amp;").replace("'", "&#39;") in plain for _, sentence in run.verdicts)
    assert set(run.figures) == set(re.findall(r'id="figure-([\w-]+)"', page))


def test_the_model_predicts_the_poses_that_were_measured(run: truing.Run) -> None:
    model = run.model
    assert isinstance(model, truing.ExtendedModel)
    assert model.model.nominal.count == 6


def test_a_folder_without_a_run_is_told(tmp_path: Path) -> None:
    pq.write_table(pa.table({"pose": [1]}), tmp_path / "poses.parquet")  # of another making
    with pytest.raises(FileNotFoundError, match="found no table of a run"):
        truing.load(tmp_path)


def test_a_table_that_the_run_lacks_or_that_breaks_its_schema_is_told(run: truing.Run, tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="this run has observations"):
        run["pose"]
    table = run.table("poses")
    broken = table.set_column(table.schema.get_field_index("px_mm"), "px_mm", pa.array(np.full(len(table), np.inf)))
    pq.write_table(broken, tmp_path / "poses.parquet")
    with pytest.raises(ValueError, match=r"poses\.parquet.*px_mm.*finite"):
        truing.load(tmp_path)["poses"]
