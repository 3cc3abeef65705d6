"""Arbitrary bytes in campaign files are read or refused with a fault; no crash, no warning, no endless run."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from tests.broken.oracle import contents, lay_out, misbehaviour
from tests.broken.subjects import SUBJECTS, Subject, good_files
from truing.pipeline.command_line import app

_EACH = 1  # `python -m tests.broken.fuzz` goes on for as long as is wished


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: f"{subject.name}-{subject.form}")
@settings(max_examples=_EACH, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_damaged_file_is_read_or_refused(subject: Subject, data: st.DataObject, tmp_path: Path) -> None:
    content = data.draw(contents(subject))
    lay_out(subject, tmp_path, content)
    assert misbehaviour(tmp_path) is None


@settings(max_examples=6, suppress_health_check=list(HealthCheck))
@given(subject=st.sampled_from(SUBJECTS), content=st.binary(max_size=200))
def test_arbitrary_bytes_are_refused(subject: Subject, content: bytes, tmp_path: Path) -> None:
    lay_out(subject, tmp_path, content)
    assert misbehaviour(tmp_path) is None


@pytest.mark.parametrize("campaign", sorted({subject.campaign for subject in SUBJECTS}))
def test_the_campaigns_that_are_damaged_are_good(campaign: str, tmp_path: Path) -> None:
    for name, content in good_files(campaign).items():
        (tmp_path / name).write_bytes(content)
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert done.exit_code == 0, done.output
