"""Tables as they stand on a page of the docs, between the marks that its command writes them in."""

from __future__ import annotations


def shown(page: str, name: str) -> str:
    """Return the table of a name as it stands on a page's text."""
    return page.split(f"<!-- table {name} -->\n")[1].split("\n<!-- end -->")[0]
