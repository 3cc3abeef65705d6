"""Folders of stages do not import each other, and unrelated code makes no stage stale."""

from __future__ import annotations

import re
from functools import cache

import pytest

from tests.packaging.source_tree import PROJECT, imported_names, module_name, modules, within
from truing.pipeline.manifest import DigestCache
from truing.pipeline.source_digest import SourceTree

SHARED = ("truing.stages.common", "truing.stages.declaration")
FOLDERS = sorted({path.parent.name for path in modules("stages") if path.parent != PROJECT / "stages"})
CAUSES, SEARCH = re.compile(r"truing/simulation/\w+/causes/"), re.compile(r"truing/inference/")
MODELS = re.compile(r"truing/simulation/(bench|bodies|mechanisms|photographs)/\w+\.py")
ADJUSTMENTS = re.compile(r"truing/estimation/(bundle/(adjustment|snooping)|rigid_poses/correlated_poses)\.py")


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_folder_of_stages_imports_only_itself_and_shared_modules(folder: str) -> None:
    allowed = (f"truing.stages.{folder}", *SHARED)
    faults = {
        module_name(path): strange
        for path in modules(f"stages/{folder}")
        if (strange := [name for name in _of_stages(imported_names(path)) if not any(within(name, a) for a in allowed)])
    }
    assert not faults


def _of_stages(names: set[str]) -> list[str]:
    """Names of modules of stages; for `from truing.stages.a import b` the module alone."""
    return sorted(name for name in names if within(name, "truing.stages"))


@cache
def closure(stage: str) -> tuple[str, ...]:
    """The files that decide whether a stage is stale."""
    return tuple(SourceTree(PROJECT, DigestCache(None)).digests(f"truing.stages.{stage}"))


@pytest.mark.parametrize("stage", ["images", "ingest", "bundle", "qa", "pose", "deformation"])
def test_a_change_in_a_cause_makes_no_stage_stale_that_knows_none(stage: str) -> None:
    assert [file for file in closure(stage) if CAUSES.match(file) or SEARCH.match(file)] == []


def test_a_change_in_a_model_or_in_an_adjustment_makes_no_quality_check_stale() -> None:
    assert [file for file in closure("qa") if MODELS.match(file) or ADJUSTMENTS.match(file)] == []


def test_a_change_in_a_cause_makes_the_diagnosis_stale() -> None:
    assert all(any(map(pattern.match, closure("diagnose"))) for pattern in (CAUSES, SEARCH))
