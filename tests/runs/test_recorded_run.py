"""A reopened run has the same tables, sentences, figures and model."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import truing
from truing.runs.recorded_run import PageFigures
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


def test_a_returned_table_is_a_copy(run: truing.Run) -> None:
    poses = run["poses"]
    poses["px_mm"] = 0.0
    assert (run["poses"]["px_mm"] != 0.0).any()


@pytest.mark.slow
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


def test_a_folder_without_a_run_is_reported(tmp_path: Path) -> None:
    pq.write_table(pa.table({"pose": [1]}), tmp_path / "poses.parquet")  # of another making
    with pytest.raises(FileNotFoundError, match="found no table of a run"):
        truing.load(tmp_path)


def test_a_table_that_the_run_lacks_or_that_breaks_its_schema_is_reported(run: truing.Run, tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="this run has observations"):
        run["pose"]
    table = run.table("poses")
    broken = table.set_column(table.schema.get_field_index("px_mm"), "px_mm", pa.array(np.full(len(table), np.inf)))
    pq.write_table(broken, tmp_path / "poses.parquet")
    with pytest.raises(ValueError, match=r"poses\.parquet.*px_mm.*finite"):
        truing.load(tmp_path)["poses"]


def test_poses_have_rotations_and_covariance_in_si(run: truing.Run) -> None:
    table = run["poses"].query("default")
    poses = run.poses()
    assert len(poses) == len(table)
    platform, own = run.poses("platform"), table[table["body"] == "platform"]
    np.testing.assert_allclose(platform.position[:, 1] * 1e3, own["py_mm"])
    np.testing.assert_allclose(platform.rotation.as_rotvec()[:, 2], own["rz_rad"], atol=1e-12)
    np.testing.assert_array_equal(platform.covariance, np.swapaxes(platform.covariance, 1, 2))
    np.testing.assert_allclose(platform.covariance[:, 1, 4], own["cov_1_4"])
    assert (np.linalg.eigvalsh(platform.covariance) > 0.0).all()
    assert set(platform.parent) == {"base"}
    assert platform.is_determined.all()
    with pytest.raises(KeyError, match="did you mean platform"):
        run.poses("platfrom")


def test_poses_that_could_not_be_determined_are_marked(run: truing.Run) -> None:
    from truing.runs.run_frames import poses_of

    table = run["poses"].query("default").head(3).copy()
    table.loc[table.index[1], ["px_mm", "rx_rad"]] = np.nan
    poses = poses_of(table)
    assert poses.is_determined.tolist() == [True, False, True]
    assert np.isnan(poses.position[1]).any()


def test_causes_are_one_row_per_parameter_with_its_unit(run: truing.Run) -> None:
    causes = run.causes()
    assert set(causes["cause"]) == {"platform-deformation-matrix"}
    assert len(causes) == 36
    assert set(causes["unit"]) == {"1"}
    assert (causes["sigma"] > 0.0).all()
    known = run["uncertainty"].query("result == 'cause'").set_index("quantity")["estimate"]
    np.testing.assert_allclose(causes.set_index("parameter")["value"], known[causes["parameter"]], rtol=1e-6)


def test_parameters_are_those_with_a_stated_uncertainty_without_poses(run: truing.Run) -> None:
    parameters = run.parameters()
    assert set(parameters["source"]) == {"calibration", "cause"}
    assert set(parameters["unit"]) <= {"mm", "1"}
    assert (parameters["expanded_uncertainty"] > parameters["sigma"]).all()


def test_a_notebook_shows_the_verdict(run: truing.Run) -> None:
    html = run._repr_html_()
    assert "<b>telescope</b>" in html
    for row in run.verdict.to_dict("records"):
        assert f"<td>{row['section']}</td><td>{row['state']}</td>" in html


def test_a_terminal_shows_the_verdict_and_no_list_of_files(run: truing.Run) -> None:
    lines = repr(run).splitlines()
    assert lines[0].startswith("telescope: a run with")
    for row in run.verdict.to_dict("records"):
        (own,) = [line for line in lines if line.startswith(f"{row['section']} ({row['state']})")]
        assert row["explanation"].split()[0] in own
    assert ".parquet" not in repr(run)
    assert max(map(len, lines[1:])) <= 100


def test_an_unknown_table_is_answered_with_a_near_name(run: truing.Run) -> None:
    with pytest.raises(KeyError, match="did you mean poses"):
        run["pose"]


def test_opening_a_run_imports_no_library_of_tables_or_figures(run: truing.Run) -> None:
    """These take longer than everything else; they are imported when a table or figure is asked for."""
    found = "[name for name in ('pandas', 'scipy', 'plotly') if name in sys.modules]"
    work = "run.poses(), run.causes(), run.parameters()"
    script = f"import sys, truing; run = truing.load(sys.argv[1]); print({found}); {work}; print({found})"
    done = subprocess.run([sys.executable, "-c", script, str(run.folder)], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "['pandas']"]


def test_poses_are_printed_by_number_and_first_rows(run: truing.Run) -> None:
    poses = run.poses("platform")
    lines = repr(poses).splitlines()
    assert lines[0] == f"{len(poses)} poses of platform; all determined"
    assert lines[-1] == f"... and {len(poses) - 6} more"
    assert len(lines) == 9
    assert max(map(len, lines)) < 160
    assert poses._repr_html_().count("<tr>") == 6
    frame = poses.frame()
    np.testing.assert_allclose(frame["sigma_rz_rad"] ** 2, poses.covariance[:, 5, 5])
    np.testing.assert_array_equal(frame["x_m"], poses.position[:, 0])


def test_wrong_names_of_figures_and_folders_are_answered_with_near_names(tmp_path: Path) -> None:
    (tmp_path / "telescope").mkdir()
    with pytest.raises(FileNotFoundError, match="did you mean telescope"):
        truing.load(tmp_path / "telescop")
    with pytest.raises(KeyError, match="did you mean evidence-0"):
        PageFigures({"evidence-0": go.Figure()})["evidense-0"]
