"""The order of stages, written once per kind of campaign; what depends on what follows from the declarations."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

from truing.formats.source import OF_IMAGES, OTHERS

if TYPE_CHECKING:
    from truing.stages.declaration import Stage

_EVERY = ("ingest", "qa", "pose", "deformation", "diagnose", "calibrate", "transfer", "uncertainty", "report")
# What a second campaign is predicted by, and the stages of that campaign whose tables it is given.
OF_SECOND_CAMPAIGNS = {"transfer": ("ingest", "qa", "pose")}
OF_PHOTOGRAPHS = ("images", "bundle")  # stages that a campaign without photographs does without

ORDER: dict[str, tuple[str, ...]] = {
    "photogrammetry": (*OF_PHOTOGRAPHS, *_EVERY),
    "interferometer": _EVERY,
}

# The stages that see raw files, through truing.formats, and which tables of [files] are theirs.
RAW_READERS: dict[str, tuple[str, ...]] = {"images": OF_IMAGES, "bundle": ("targets",), "ingest": OTHERS}
# Stages with work in independent pieces: they are given what does these in several processes.
IN_PIECES = ("images",)


def order_of(kind: str, *, photographs: bool, second: bool = False) -> tuple[str, ...]:
    """The stages of a campaign of a kind, in order; second: whether its models predict a second campaign."""
    left_out = {*(() if photographs else OF_PHOTOGRAPHS), *(() if second else OF_SECOND_CAMPAIGNS)}
    return tuple(name for name in ORDER[kind] if name not in left_out)


def stage_module(name: str) -> ModuleType:
    """The module of a stage, imported."""
    return importlib.import_module(f"truing.stages.{name}")


def is_optional(artifact: str) -> bool:
    """Whether a declared artifact is marked as one that may be absent."""
    return artifact.endswith("?")


def bare(artifact: str) -> str:
    """A declared artifact's name without its mark."""
    return artifact.removesuffix("?")


def makers(order: tuple[Stage, ...]) -> dict[str, str]:
    """Which stage leaves which artifact; raises ValueError where two leave the same, or one is read too early."""
    found: dict[str, str] = {}
    for stage in order:
        for artifact in stage.reads:
            if bare(artifact) not in found and not is_optional(artifact):
                raise ValueError(f"{stage.name} reads {artifact}, which no stage before it leaves")
        for artifact in map(bare, stage.leaves):
            if artifact in found:
                raise ValueError(f"{artifact} is left by {found[artifact]} and by {stage.name}")
            found[artifact] = stage.name
    return found


def needed_for(target: str, order: tuple[Stage, ...]) -> tuple[Stage, ...]:
    """A stage and everything that it depends on, in order."""
    maker = makers(order)
    wanted = {target}
    for stage in reversed(order):
        if stage.name in wanted:
            wanted.update(maker[name] for name in map(bare, stage.reads) if name in maker)
    return tuple(stage for stage in order if stage.name in wanted)
