"""Names that differ only in spelling are recognised, others are not."""

from __future__ import annotations

import pytest

from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.schemas.near_names import (
    did_you_mean,
    is_one_slip_apart,
    meant_by,
    mistyped_name,
    nearest_name,
    similar_names,
)


@pytest.mark.parametrize(("name", "known"), [("p1", "P01"), ("P 01", "P01"), ("platform", "Platform"), ("p_1", "P1")])
def test_a_name_spelled_otherwise_is_the_one_that_is_meant(name: str, known: str) -> None:
    assert nearest_name(name, ["P11", "other", known]) == known
    assert list(similar_names([name, "other", known])) == [[name, known]]


@pytest.mark.parametrize(("name", "known"), [("P2", "P1"), ("1.05", "1.5"), ("1-2", "12"), ("10", "100")])
def test_names_with_other_numbers_are_other_names(name: str, known: str) -> None:
    assert meant_by([name], [known]) == ""
    assert list(similar_names([name, known])) == []


def test_a_mistyped_letter_is_reported_with_its_element() -> None:
    assert did_you_mean("platfrom", ["base", "platform"]) == "; did you mean platform?"
    assert meant_by(["other", "p7"], ["P07"]) == "; did you mean P07 by p7?"


@pytest.mark.parametrize(
    ("name", "known"), [("temprature_c", "temperature_c"), ("Time_S", "time_s"), ("roles", "role"), ("rloe", "role")]
)
def test_a_letter_too_many_too_few_or_exchanged_is_a_mistyped_name(name: str, known: str) -> None:
    assert mistyped_name(name, ["series", known]) == known


@pytest.mark.parametrize("name", ["temperature2_c", "temperature_leg_c", "load", "rule_of_thumb"])
def test_another_quantity_is_no_mistyped_name(name: str) -> None:
    assert mistyped_name(name, ["temperature_c", "role", "time_s", "series"]) is None


@pytest.mark.parametrize(("name", "other"), [("P20", "P02"), ("B0E", "B03"), ("B3", "B03"), ("B003", "B03"), ("B", "")])
def test_names_one_slip_apart(name: str, other: str) -> None:
    assert is_one_slip_apart(name, other)
    assert is_one_slip_apart(other, name)


@pytest.mark.parametrize(("name", "other"), [("B03", "B03"), ("B03", "b03"), ("P21", "P03"), ("P120", "P012x")])
def test_equal_names_and_those_with_several_slips_are_not_one_slip_apart(name: str, other: str) -> None:
    assert not is_one_slip_apart(name, other)


@pytest.mark.parametrize(
    ("key", "value", "meant"), [("mechanism.type", "6-psu", "6-pus"), ("measurement.frame", "campagn", "campaign")]
)
def test_a_mistyped_value_of_a_key_gets_a_suggestion(key: str, value: str, meant: str) -> None:
    section, name = key.split(".")
    document = {"campaign": {"name": "a", "kind": "photogrammetry"}, section: {name: value}}
    with pytest.raises(CampaignFaults) as caught:
        read_campaign(document)
    (fault,) = [fault for fault in caught.value.faults if fault.column == key]
    assert fault.value == value
    assert fault.expected.endswith(f"did you mean {meant}?")
