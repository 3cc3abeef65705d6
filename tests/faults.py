"""Finds a fault by its facts: file, row, column and value."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest

from truing.schemas.faults import CampaignFaults, Fault


def faults_of(read: Callable[[], object]) -> tuple[Fault, ...]:
    """The faults that reading a campaign raises."""
    with pytest.raises(CampaignFaults) as caught:
        read()
    return caught.value.faults


def assert_fault(faults: Iterable[Fault], **facts: str | int | None) -> Fault:
    """The one fault with these facts (fields of ``Fault``)."""
    listed = list(faults)
    alike = [one for one in listed if all(getattr(one, name) == value for name, value in facts.items())]
    assert len(alike) == 1, f"{len(alike)} faults with {facts} among: {[str(fault) for fault in listed]}"
    return alike[0]
