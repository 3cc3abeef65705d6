"""Counts of one are singular in all sentences, and percentages have no powers of ten."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.schedule import random_moves
from tests.conftest import PROJECT
from tests.stages.line import run_line
from truing.report.diagnosis.adequacy import adequacy
from truing.report.numbers import count_text, gross_errors, percent

# Words in the singular that end in s.
SINGULAR = {"times", "is", "was", "has", "axis", "pass", "s", "across", "as", "less", "gas", "bus", "this"}

# What has a number for a name: "run 1 reads".
NUMBERED = ("run", "pose", "step", "row", "leg", "camera", "target", "channel", "survey", "actuator", "axis", "image")


def plurals_of_one(said: str) -> list[str]:
    """Places in a text that tell of one thing in the plural; of a fraction, a range or a unit 1 is no count."""
    named = "".join(rf"(?<!\b{what} )" for what in NUMBERED)
    found = re.finditer(rf"(?<![\d.,/=*^±-]){named}\b1 ((?:[a-z]+ )?[a-z]+s)\b", said)
    return [one[0] for one in found if one[1].split()[-1] not in SINGULAR and one[1].split()[0] not in SINGULAR]


@pytest.mark.parametrize("sample", ["telescope", "force-sensor"])
def test_counts_of_one_in_lines_of_the_samples_are_in_the_singular(sample):
    tables, said = run_line(PROJECT / "sample_data" / sample, "ingest", "qa", "pose", "deformation")
    lines = [text for one in said.values() for text in (one.read, one.left_out, one.figure)]
    lines += tables["qa"].column("message").to_pylist()
    assert len(lines) > 60
    assert not [line for line in map(str, lines) if plurals_of_one(line)]


def test_lines_of_a_campaign_of_one_pose_are_in_the_singular(tmp_path):
    numbers = np.random.default_rng(3)
    layout = Layout(name="u", targets=Targets(per_leg=0))
    made = write_campaign(draw_campaign(layout, random_moves(1, 0, numbers), [], numbers), tmp_path / "c", 3)
    tables, said = run_line(made, "ingest", "qa", "pose")
    lines = [text for one in said.values() for text in (one.read, one.left_out, one.figure)]
    lines += tables["qa"].column("message").to_pylist()
    assert any("1 pose" in str(line) for line in lines)
    assert not [line for line in map(str, lines) if plurals_of_one(line)]


@pytest.mark.parametrize(
    ("number", "noun", "said"),
    [
        (1, "run", "1 run"),
        (2, "body", "2 bodies"),
        (3, "approach", "3 approaches"),
        (1200, "load step", "1,200 load steps"),
    ],
)
def test_a_count_agrees_with_its_noun(number, noun, said):
    assert count_text(number, noun) == said


def test_gross_errors_and_percentages_read_as_words_and_numbers():
    assert gross_errors(1, "reading") == "1 reading as a gross error"
    assert gross_errors(2, "shift") == "2 shifts as gross errors"
    assert percent(100.0 * float(np.expm1(0.7))) == "101 %"


def test_a_plural_of_one_is_found():
    assert plurals_of_one("read 1 images of 2 cameras; left out 1 load steps") == ["1 images", "1 load steps"]
    assert not plurals_of_one("1 pose is 2.1 times; 0.1 rays; 1 axis; 21 runs; 1 times; run 1 reads")


def test_tests_of_the_final_model_are_counted_as_their_table_lists_them() -> None:
    rows = [("causes-left", "ok"), ("observation-noise", "ok"), ("like-neighbours", "ok"), ("pure-error", "not tested")]
    table = pd.DataFrame(rows, columns=["test", "state"]).assign(along="time_s", value=1.0, p_value=0.5, limit=0.02)
    section = adequacy({"adequacy": table})
    assert section is not None
    assert section.lead.startswith("3 tests of the final model: ")
    assert section.listings[0].caption == "All 4 tests, 3 of them evaluated"
    assert len(section.listings[0].rows) == 4
