"""Every key of campaign.toml takes its documented type only, and the fault names the key."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from datetime import date
from types import UnionType
from typing import Any, Literal

import pytest
from pydantic import BaseModel

from truing.schemas.campaign import Campaign, read_campaign
from truing.schemas.faults import CampaignFaults
from truing.schemas.mechanism import LeggedMechanism, NoMechanism, SensorMechanism
from truing.schemas.section import LONGEST_NAME, LONGEST_TEXT

Place = tuple[str | int, ...]

_MECHANISMS = {"ups": LeggedMechanism, "6-upur": SensorMechanism, "none": NoMechanism}
_NO_NUMBERS = [True, "0.005", "1", float("nan"), float("inf"), -float("inf"), {}, date(2026, 1, 1)]
_NO_FLAGS = ["yes", "true", 1, 0, 1.0, []]
_NO_TEXT = [True, 5, 0.5, {}, "a\0b", "\x1b[31mred", "a\x7f", "a\u202eb", "a\u2028b"]
_NO_DATES = [True, 5, 0.5, "today", "2026-02-30", [], {}]
_NO_IDENTIFIERS = [True, 0.5, float("nan"), [], {}, "a\0b", "a\nb", "", " ", "x" * (LONGEST_NAME + 1), 1 << 64]
# May be empty, hold ends of lines or be as long as a system takes: what a file of others holds, and its path.
_OF_FILES, _PATHS = "files", ("model", "compliance_file", "deformation_file", "judge_on", "logo")


def _kinds(annotation: Any) -> set[Any]:
    """The bare types within an annotation; those of several are one key that takes any of them."""
    if typing.get_origin(annotation) is typing.Annotated:
        return _kinds(typing.get_args(annotation)[0])
    if typing.get_origin(annotation) in (typing.Union, UnionType):
        return {kind for one in typing.get_args(annotation) if one is not type(None) for kind in _kinds(one)}
    return {annotation}


def _keys(annotation: Any, place: Place) -> Iterator[tuple[Place, set[Any]]]:
    """Every place below this one that holds a value, with the types that it takes."""
    kinds = _kinds(annotation)
    models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    for model in models:
        for key, field in model.model_fields.items():
            yield from _keys(field.annotation, (*place, key))
    for kind in kinds:
        if typing.get_origin(kind) is tuple:
            yield from _keys(typing.get_args(kind)[0], (*place, 0))
        if typing.get_origin(kind) is dict:
            yield from _keys(typing.get_args(kind)[1], (*place, "x_mm"))
    if not models:
        yield place, {typing.get_origin(kind) or kind for kind in kinds}


def _all_keys() -> Iterator[tuple[str, Place, set[Any]]]:
    for key, field in Campaign.model_fields.items():
        if key != "mechanism":
            yield from (("none", *one) for one in _keys(field.annotation, (key,)))
    for kind, model in _MECHANISMS.items():
        yield from ((kind, *one) for one in _keys(model, ("mechanism",)))


KEYS = [one for one in _all_keys() if one[1] not in {("format",), ("mechanism", "type")}]


def _faults(kind: str, place: Place, value: Any) -> list[str]:
    """Faults of an otherwise almost empty campaign with this value at this place."""
    for part in reversed(place):
        value = [value] if part == 0 else {part: value}
    document = {**value}
    document["campaign"] = {"name": "c", "kind": "photogrammetry", **value.get("campaign", {})}
    document["mechanism"] = {"type": kind, **value.get("mechanism", {})}
    try:
        read_campaign(document)
    except CampaignFaults as error:
        return [str(fault.column) for fault in error.faults]
    return []


def _dotted(place: Place) -> str:
    return ".".join("1" if part == 0 else str(part) for part in place)


def _passed(kind: str, place: Place, values: list[Any]) -> list[Any]:
    """Values without a fault at this key, one of its entries, or the table that contains it."""
    dotted = _dotted(place)
    above = {_dotted(place[:-1])} if place[-1] == 0 or place[-1] == "x_mm" else set()
    return [v for v in values if not any(f == dotted or f.startswith(f"{dotted}.") or f in above
                                         for f in _faults(kind, place, v))]  # fmt: skip


def _chosen(*wanted: Any, without: tuple[Any, ...] = ()) -> list[Any]:
    return [
        pytest.param(kind, place, id=f"{kind} {_dotted(place)}")
        for kind, place, kinds in KEYS
        if kinds & set(wanted) and not kinds & set(without)
    ]


@pytest.mark.parametrize(("kind", "place"), _chosen(float, int, without=(str, bool)))
def test_a_number_is_neither_true_nor_text_nor_infinite(kind: str, place: Place) -> None:
    assert _passed(kind, place, _NO_NUMBERS) == []


@pytest.mark.parametrize(("kind", "place"), _chosen(bool))
def test_a_flag_is_true_or_false(kind: str, place: Place) -> None:
    assert _passed(kind, place, _NO_FLAGS) == []


@pytest.mark.parametrize(("kind", "place"), _chosen(str, without=(int, tuple)))
def test_text_is_text_without_what_a_terminal_obeys(kind: str, place: Place) -> None:
    is_free = place[0] == _OF_FILES or place[-1] in _PATHS
    named = [] if is_free else ["x" * (LONGEST_TEXT + 1)]
    assert _passed(kind, place, [*_NO_TEXT, *named]) == []


@pytest.mark.parametrize(("kind", "place"), _chosen(date))
def test_a_date_is_a_day(kind: str, place: Place) -> None:
    assert _passed(kind, place, _NO_DATES) == []


def test_poses_and_runs_are_whole_numbers_or_names() -> None:
    places = [(kind, place) for kind, place, kinds in KEYS if kinds == {int, str} and place[0] != _OF_FILES]
    assert len(places) == 8
    assert [(place, passed) for kind, place in places if (passed := _passed(kind, place, _NO_IDENTIFIERS))] == []


@pytest.mark.parametrize(("kind", "place"), _chosen(Literal))
def test_a_choice_is_one_of_those_there_are(kind: str, place: Place) -> None:
    assert _passed(kind, place, [True, 1, "", "no such choice", []]) == []


def test_every_key_is_of_a_kind_that_is_tried_here() -> None:
    known = {float, int, str, bool, date, Literal}
    others = {_dotted(place): kinds for _, place, kinds in KEYS if not kinds & known}
    assert all(kinds <= {tuple, dict} for kinds in others.values()), others
    assert len(KEYS) > 250


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ({"noise": {"point_mm": True}}, "noise.point_mm: found 'true'; expected a number, without quotation marks"),
        ({"noise": {"point_mm": "0.005"}}, "found '\"0.005\"'; expected a number, without quotation marks"),
        ({"photographs": {"uncoded": "yes"}}, "found '\"yes\"'; expected true or false, without quotation marks"),
        ({"format": True}, "format: found 'true'; expected 1"),
        ({"format": 1.0}, "format: found '1.0'; expected 1"),
        ({"files": {"points": {"path": 5}}}, "files.points.path: found '5'; expected a file or glob in quotation"),
        ({"files": {"points": [{"path": "a"}, {"path": 5}]}}, "files.points.2.path: found '5'"),
        ({"files": {"points": 5}}, "files.points: found '5'; expected a table"),
        ({"bodies": {"still": "pier"}}, "bodies.still: found '\"pier\"'; expected a list, in brackets"),
        ({"bodies": {"reference": "a\0b"}}, "text without control characters; it contains U+0000"),
        ({"exclude": [{"pose": "P\n7", "by": "me", "reason": "x"}]}, "exclude.1.pose: found 'P\\n7'; expected text"),
    ],
)
def test_the_fault_says_what_is_there_as_toml_writes_it(section: dict[str, Any], expected: str) -> None:
    with pytest.raises(CampaignFaults) as caught:
        read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, **section})
    assert any(expected in str(fault) for fault in caught.value.faults), [str(f) for f in caught.value.faults]


def test_joints_have_a_workspace_on_chains_only() -> None:
    with pytest.raises(CampaignFaults) as error:
        read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, "workspace": {"joints": {"a_deg": [0, 1]}}})
    assert [fault.column for fault in error.value.faults] == ["workspace.joints.a_deg"]


def test_older_campaign_files_are_read_unchanged() -> None:
    decided = {"by": "A. Lab", "on": "2026-11-22", "reason": "knocked over\nin the night"}
    document = {
        "campaign": {"name": "c", "kind": "photogrammetry"},
        "noise": {"point_mm": 1},
        "exclude": [{"pose": 7, **decided}, {"pose": "P 07", **decided, "on": date(2026, 11, 22)}],
        "files": {"points": {"path": ["a.csv", "b*.csv"], "columns": {"x_mm": "X\n[mm]", "y_mm": 2}, "missing": [""]}},
    }
    found = read_campaign(document)
    assert found.noise.point_mm == 1.0
    assert [rule.on for rule in found.exclude] == [date(2026, 11, 22)] * 2
    assert found.files["points"][0].paths == ("a.csv", "b*.csv")
