"""Lines of [certificate] for the first screen of a page: item, instrument, date."""

from __future__ import annotations


def certificate_lines(item: str, equipment: str, begin: str, end: str) -> tuple[str, ...]:
    """Lines for campaign.toml; ``begin``, ``end``: days on which a simulation stands for the measurement."""
    own = ("", "[certificate]", f"begin = {begin}", f"end = {end}")
    return *own, "", "[certificate.item]", f'name = "{item}"', "", "[[certificate.equipment]]", f'name = "{equipment}"'
