"""docs/qa.md has an entry of every check, as it is declared; its limits of a campaign's own are allowed."""

from __future__ import annotations

import re
import tomllib

import pytest

from docs.experiments.quality_checks import PAGE, TABLES
from tests.docs.shown import shown
from truing.schemas.campaign import read_campaign
from truing.schemas.quality_check import CheckLimits
from truing.schemas.quality_checks import CHECKS

TEXT = PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", TABLES)
def test_the_page_shows_what_is_declared(name: str) -> None:
    assert shown(TEXT, name) == TABLES[name]()


@pytest.mark.parametrize(("kind", "part"), list(zip(CHECKS, ("points", "loads"), strict=True)))
def test_every_check_has_its_entry(kind: str, part: str) -> None:
    entries = [row.split(" | ") for row in shown(TEXT, f"every-check-of-{part}").splitlines()[2:]]
    assert [entry[0].split("`")[1] for entry in entries] == list(CHECKS[kind])
    for (_, why, to_do), (name, check) in zip(entries, CHECKS[kind].items(), strict=True):
        if why == "[as above](#every-check-of-object-points)":
            check = CHECKS["photogrammetry"][name]
            assert (check.why, check.instructions) == (CHECKS[kind][name].why, CHECKS[kind][name].instructions)
        else:
            assert (check.why, check.instructions) == (why, to_do.removesuffix(" |"))
    rows = [row.split(" | ") for row in shown(TEXT, part).splitlines()[2:]]
    assert [row[0].split("`")[1] for row in rows] == list(CHECKS[kind])
    assert all(row[1].endswith("?") for row in rows)
    settable = [c.of if isinstance(c := check.criterion, CheckLimits) else "" for check in CHECKS[kind].values()]
    assert [row[4].strip() for row in rows] == settable


@pytest.mark.parametrize("kind", CHECKS)
def test_the_remedy_of_a_failed_check_omits_conditions_of_its_evaluation(kind: str) -> None:
    for check in CHECKS[kind].values():
        assert "evaluated:" not in check.to_do
        assert check.to_do.endswith((".", "?"))
        assert not check.not_evaluated.endswith(".")


def test_the_examples_are_allowed() -> None:
    (example,) = (block for block in re.findall(r"```toml\n(.*?)```", TEXT, re.S) if "qa.limits" in block)
    read_campaign({"campaign": {"name": "x", "kind": "photogrammetry"}, **tomllib.loads(example)})


@pytest.mark.parametrize(
    ("kind", "heading"), [("photogrammetry", "Photogrammetry"), ("interferometer", "A force bench")]
)
def test_before_dismantling_every_check_is_looked_at(kind: str, heading: str) -> None:
    text = (PAGE.parent / "before-you-dismantle.md").read_text(encoding="utf-8")
    part = text.split(f"## {heading}\n")[1].split("\n## ")[0]
    named = set(re.findall(r"`([a-z]+(?:-[a-z]+)*)`", part))
    assert named == set(CHECKS[kind]) - {"signals"}  # which says that a campaign holds none
