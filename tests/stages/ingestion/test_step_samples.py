"""Samples of a load step are averaged if declared, and otherwise a fault."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.faults import assert_fault, faults_of
from tests.tolerance import assert_close
from truing.pipeline.in_memory import stage_line
from truing.schemas.faults import CampaignFaults

HEAD = '[campaign]\nname = "s"\nkind = "interferometer"\n[noise]\nlinear_um = 0.1\n'


def campaign(folder: Path, text: str, *, averaged: bool) -> Path:
    more = "[interferometer]\naverage_samples = true\n" if averaged else ""
    (folder / "campaign.toml").write_text(f'{HEAD}{more}[files.interferometer]\npath = "log.csv"\nmissing = ["x"]\n')
    (folder / "log.csv").write_text(f"run,step,time_s,load_axis,load,channel,reading,room\n{text}")
    return folder


def logged(rng, samples=5):
    """Three steps of two channels, sample by sample: rows, and the means of each step and channel."""
    rows, means = [], {}
    for step, load in enumerate((0.0, 100.0, 0.0)):
        at = 10.0 * step + np.arange(samples)
        read = {name: rng.normal(load, 1.0, samples) for name in ("dx", "dz")}
        room = rng.normal(20.0, 0.1, samples)
        for k in range(samples):
            rows += [f"1,{step},{at[k]},fz,{load},{name},{read[name][k]!r},{room[k]!r}" for name in read]
        means |= {(step, name): (at.mean(), values.mean(), room.mean()) for name, values in read.items()}
    return "\n".join(rows).replace("np.float64(", "").replace(")", "") + "\n", means


def test_the_mean_of_the_samples_is_the_reading(tmp_path):
    text, means = logged(np.random.default_rng(4))
    line = stage_line(campaign(tmp_path, text, averaged=True)).call("ingest")
    found = {(row["step"], row["channel"]): row for row in line.tables["readings"].to_pylist()}
    assert found.keys() == means.keys()
    for key, (time, reading, room) in means.items():
        assert_close(found[key]["time_s"], time, atol=1e-9)
        assert_close([found[key]["reading"], found[key]["room"]], [reading, room], atol=1e-9)


def test_undeclared_repeated_samples_are_a_fault(tmp_path):
    text, _ = logged(np.random.default_rng(4))
    with pytest.raises(CampaignFaults, match="every run, step, channel once"):
        stage_line(campaign(tmp_path, text, averaged=False)).call("ingest")


def test_a_sample_that_is_missing_is_no_sample(tmp_path):
    text = "1,0,0,fz,0,dz,1.0,20\n1,0,1,fz,0,dz,x,20\n1,0,2,fz,0,dz,3.0,20\n1,1,9,fz,5,dz,x,20\n1,2,12,fz,0,dz,4.0,20\n"
    line = stage_line(campaign(tmp_path, text, averaged=True)).call("ingest")
    assert [(row["step"], row["reading"]) for row in line.tables["readings"].to_pylist()] == [(0, 2.0), (2, 4.0)]


def test_a_sample_in_transit_enters_no_mean_and_is_counted(tmp_path):
    (tmp_path / "campaign.toml").write_text(
        f'{HEAD}[interferometer]\naverage_samples = true\n[files.interferometer]\npath = "log.csv"\n'
        "[files.interferometer.rename]\ntransit = { moving = '1', held = '0' }\n"
    )
    rows = "1,0,0,fz,0,dz,1,held\n1,0,1,fz,1,dz,2,held\n1,0,2,fz,60,dz,50,moving\n1,1,3,fz,100,dz,90,held\n"
    (tmp_path / "log.csv").write_text(f"run,step,time_s,load_axis,load,channel,reading,transit\n{rows}")
    line = stage_line(tmp_path)
    line.call("ingest")
    found = line.tables["readings"].to_pylist()
    assert [(row["step"], row["reading"], row["fz_n"], row["time_s"]) for row in found] == [
        (0, 1.5, 0.5, 0.5),
        (1, 90.0, 100.0, 3.0),
    ]
    assert "transit" not in line.tables["readings"].column_names
    left = line.tables["exclusions"].to_pylist()
    assert [(row["rows"], row["reason"]) for row in left] == [(1, "samples in transit between loads")]


def test_loads_and_times_are_means_of_the_samples_that_have_a_reading(tmp_path):
    text = "1,0,0,fz,0,dz,1.0,20\n1,0,9,fz,90,dz,x,29\n1,0,2,fz,2,dz,3.0,22\n"
    line = stage_line(campaign(tmp_path, text, averaged=True)).call("ingest")
    row = line.tables["readings"].to_pylist()[0]
    assert (row["reading"], row["fz_n"], row["time_s"], row["room"]) == (2.0, 1.0, 1.0, 21.0)


def test_samples_of_one_step_agree_in_what_they_say_in_words(tmp_path):
    text = "1,0,0,fz,0,dz,1.0,20\n1,0,1,fx,0,dz,1.0,20\n"
    faults = faults_of(lambda: stage_line(campaign(tmp_path, text, averaged=True)).call("ingest"))
    assert_fault(faults, row=3, column="load_axis", value="fx")
