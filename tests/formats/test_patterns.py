"""Expressions, templates and time formats of campaign.toml agree with `re`, and end within their time limit."""

from __future__ import annotations

import re

import pytest

from tests.formats.reading import read, written
from truing.formats.origins import joined_by
from truing.formats.patterns import BoundedPattern, TooSlow
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults

ENDLESS = r"(?P<{}>(?:a|aa)+)"  # every way of making a row of these letters from one and two
LETTERS = "a" * 60 + "!"
HEAD = "pose,body,target,x_mm,y_mm,z_mm\n"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("from_name", ENDLESS.format("pose") + r"\.csv"),
        ("split", {"target": ENDLESS.format("body")}),
        ("select", {"target": ENDLESS.format("x")}),
        ("rename", {"target": {ENDLESS.format("x"): "b"}}),
        ("keep_lines", ENDLESS.format("x") + "$"),
        ("ignore", ENDLESS.format("x")),
    ],
)
def test_an_expression_that_never_ends_is_given_up(tmp_path, monkeypatch, key, value):
    monkeypatch.setattr("truing.formats.patterns.SECONDS", 0.05)
    table = "configurations" if key == "ignore" else "points"
    text = f"pose,{LETTERS}\n1,2\n" if key == "ignore" else f"{HEAD}1,b,{LETTERS},1,2,3\n"
    written(tmp_path, f"{LETTERS}.csv", f"{LETTERS}\n{text}" if key == "keep_lines" else text)
    entry = {"path": "a*.csv", key: value, **({"skip_lines": 1} if key == "keep_lines" else {})}
    if key == "keep_lines":
        entry = {"path": "a*.csv", key: value, "header": False, "columns": {"x_mm": 1}}
    faults = [fault for fault in read(tmp_path, table, entry).faults if "an expression that takes" in fault.expected]
    assert [(fault.file, (fault.column or "").split(".")[:3]) for fault in faults] == [
        ("campaign.toml", ["files", table, key])
    ]
    assert str(faults[0].value).startswith("aaaa")


@pytest.mark.parametrize("text", ["T12_a", "ärmel 3", "T12_a\n", "", "x" * 500])
@pytest.mark.parametrize(
    "expression", [r"(?P<t>\w+?)[_ ](?P<n>\w)", r"T\d+.*", "x+", r"(?i)t12_A", r"^ärm|a$", r"(?!T).*"]
)
def test_bounded_patterns_match_as_re_does(expression, text):
    for ours, theirs in (
        (BoundedPattern(expression, "k"), re.compile(expression)),
        (BoundedPattern(expression.encode(), "k"), re.compile(expression.encode())),
    ):
        assert dict(ours.groupindex) == dict(theirs.groupindex)
        content = text if isinstance(theirs.pattern, str) else text.encode()
        for method in ("search", "fullmatch"):
            one, other = getattr(ours, method)(content), getattr(theirs, method)(content)
            assert (one and (one.span(), one.groups())) == (other and (other.span(), other.groups()))


def test_many_texts_of_which_each_is_slow_are_too_slow_together(monkeypatch):
    monkeypatch.setattr("truing.formats.patterns._IN_ALL", 0.0)
    monkeypatch.setattr("truing.formats.patterns._PER_TEXT", 0.0)
    with pytest.raises(TooSlow):
        BoundedPattern("a+", "k").search("aaa")
    monkeypatch.setattr("truing.formats.patterns._LONGEST", 2)
    with pytest.raises(TooSlow):
        BoundedPattern("b+", "k").search("aaa")
    assert BoundedPattern("b", "k").search("aaa") is None  # without a repeat nothing takes long


def test_a_template_looks_nothing_up_in_a_value():
    assert joined_by("{set.no}-{ID[0]}", ["7", "a"]) == "7-a"
    assert joined_by("{ID:0>3}/{{{x}}}", ["7", "a"]) == "007/{a}"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("keep_lines", "(" * 5000 + ")" * 5000),
        ("keep_lines", "a{99999999999}"),
        ("keep_lines", "a|" * 10_000 + "a"),
        ("select", {"target": "["}),
        ("join", {"pose": "{ID:0>9999999999}"}),
        ("join", {"pose": "{ID!r}"}),
        ("join", {"pose": "{ID:{x}}"}),
        ("join", {"pose": "{ID:d}"}),
        ("join", {"pose": "{ID"}),
        ("wide", "{target}{target}_{axis}"),
        ("wide", "{my target}_{axis}"),
        ("wide", "{target:>9}_{axis}"),
        ("rename", {"target": {"A(.)": "\\2"}}),
        ("rename", {"target": {"A": "\\g<x>"}}),
        ("rename", {"target": {"A": "\\q"}}),
        ("time_format", "%d%d"),
        ("time_format", "%Q"),
        ("time_format", "%H:%"),
    ],
)
def test_an_invalid_pattern_is_a_fault_of_its_key(key, value):
    campaign = {"campaign": {"name": "c", "kind": "photogrammetry"}, "files": {"points": {"path": "p.csv", key: value}}}
    with pytest.raises(CampaignFaults) as caught:
        read_campaign(campaign)
    assert [(fault.column or "").split(".")[:3] for fault in caught.value.faults] == [["files", "points", key]]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("time_format", "%Y-%m-%d %H:%M:%S.%f"),
        ("time_format", "%j %I %p"),
        ("rename", {"target": {"A(?P<n>.)": "\\1\\g<n>"}}),
        ("join", {"pose": "{trial}-{frame:0>5}"}),
        ("wide", "{body}.{target}_{axis}"),
    ],
)
def test_a_valid_pattern_is_no_fault(key, value):
    read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, "files": {"points": {"path": "p", key: value}}})
