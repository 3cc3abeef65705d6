"""Tables of docs/next-campaign.md are those of its command, and show what the page claims."""

from __future__ import annotations

from docs.experiments import next_campaign
from tests.docs.shown import shown

PAGE = next_campaign.PAGE.read_text(encoding="utf-8")


def _cells(name: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in shown(PAGE, name).splitlines()[2:]]


def test_every_case_has_its_row_and_none_names_what_did_not_change() -> None:
    rows = _cells("changes")
    assert [row[0] for row in rows] == [case.name for case in next_campaign.CASES]
    for _, machines, reported, wrong, _ in rows:
        assert int(machines) == next_campaign.MACHINES
        assert int(wrong) <= 1
        assert int(reported) >= int(machines) - 1


def test_two_campaigns_have_smaller_sigmas_and_report_the_gain() -> None:
    median, smallest, z = (float(row[1]) for row in _cells("gain"))
    assert smallest < median < 1.0
    assert 0.6 < z < 1.2


def test_one_machine_of_each_kind_comes_out_as_the_page_says() -> None:
    """The command's own code, on a machine that is not among those of the page."""
    exchanged = next_campaign.CASES[2]
    pair = next_campaign.measured_twice(exchanged, next_campaign.MACHINES + 1)
    assert pair.names(exchanged)
    assert not pair.errs(exchanged)
