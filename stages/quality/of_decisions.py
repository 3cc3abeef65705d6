"""What a person left out or kept of a bench: how much that is, and whether it names anything that was read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from stages.quality.check import PASS, WARN, Check
from stages.quality.loading_view import LoadingView
from stages.sensor.overruled import decided

if TYPE_CHECKING:
    from schemas.campaign import Campaign
    from schemas.sections import Overrule

_VERBS = {"exclude": "excluded", "keep": "kept"}
_KEYS = ("run", "step", "channel", "pose", "body", "target")


def overruled(view: LoadingView, settings: Campaign) -> Iterator[Check]:
    """A row per [[exclude]] and [[keep]]; one that names nothing that was read warns, for it does nothing."""
    for table, rules in (("exclude", settings.exclude), ("keep", settings.keep)):
        for number, rule in enumerate(rules, 1):
            count = int(decided(view.steps, [rule], _VERBS[table]).chosen.sum())
            said = f"{_VERBS[table]} by {rule.by}: {rule.reason}"
            message = (
                f"{_named(rule)}: {count} reading{'s' * (count > 1)} {said}."
                if count
                else f"{_named(rule)}: no reading is so called, and none was {_VERBS[table]} by {rule.by}."
            )
            yield Check("overruled", f"{table} {number}", float(count), 1.0, "", PASS if count else WARN, message)


def _named(rule: Overrule) -> str:
    """What a rule names, as campaign.toml has it."""
    given = [f"{key} {value}" for key in _KEYS if (value := getattr(rule, key)) is not None]
    return ", ".join(given).capitalize() if given else "Everything"
