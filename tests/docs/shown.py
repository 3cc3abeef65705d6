"""Tables of a page between the marks of the command that writes them."""

from __future__ import annotations

import re

import pytest

NUMBER = re.compile(r"(?<![\w.])[-+−]?\d[\d,]*(?:\.\d+)?")


def shown(page: str, name: str) -> str:
    """Return the table of a name as it is on a page's text."""
    return page.split(f"<!-- table {name} -->\n")[1].split("\n<!-- end -->")[0]


def assert_shown(reported: str, found: str, *, rel: float) -> None:
    """Hold a text of a page to one that was made now: the words to the letter, its numbers to a share of themselves.

    A number that is small next to its digits may differ by one in its last.
    """
    assert NUMBER.sub("#", reported) == NUMBER.sub("#", found)
    for left, right in zip(NUMBER.findall(reported), NUMBER.findall(found), strict=True):
        value, other = (float(number.replace(",", "").replace("−", "-")) for number in (left, right))
        last = 10.0 ** -len(left.partition(".")[2])
        assert other == pytest.approx(value, rel=rel, abs=1.01 * last), f"{reported}\n{found}"
