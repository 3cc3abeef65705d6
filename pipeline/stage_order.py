"""Order of stages per kind of campaign; dependencies follow from the declarations."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

from truing.formats.source import LOGO, OF_IMAGES, OTHERS

if TYPE_CHECKING:
    from truing.stages.declaration import Stage

_EVERY = ("ingest", "qa", "pose", "deformation", "diagnose", "calibrate", "transfer", "uncertainty", "report")
# Stage that predicts a second campaign, and the stages of that campaign whose tables it receives.
OF_SECOND_CAMPAIGNS = {"transfer": ("ingest", "qa", "pose")}
PAGE = "report"  # stage that writes the page
OF_PHOTOGRAPHS = ("images", "bundle")  # stages of campaigns with photographs only

ORDER: dict[str, tuple[str, ...]] = {
    "photogrammetry": (*OF_PHOTOGRAPHS, *_EVERY),
    "interferometer": _EVERY,
}

# Stages that read raw files through truing.formats, and their tables of [files].
RAW_READERS: dict[str, tuple[str, ...]] = {
    "images": OF_IMAGES,
    "bundle": ("targets",),
    "ingest": OTHERS,
    PAGE: (LOGO, *OF_IMAGES, *OTHERS),  # it names all of them with their digests
}
# Stages with independent pieces of work, which can run in several processes.
IN_PIECES = ("images",)


def order_of(kind: str, *, photographs: bool, second: bool = False) -> tuple[str, ...]:
    """Stages of a kind of campaign, in order; second: whether its models predict a second campaign."""
    left_out = {*(() if photographs else OF_PHOTOGRAPHS), *(() if second else OF_SECOND_CAMPAIGNS)}
    return tuple(name for name in ORDER[kind] if name not in left_out)


def stage_module(name: str) -> ModuleType:
    """Imported module of a stage."""
    return importlib.import_module(f"truing.stages.{name}")


def is_optional(artifact: str) -> bool:
    """True if a declared artifact is marked as optional."""
    return artifact.endswith("?")


def without_mark(artifact: str) -> str:
    """Name of a declared artifact without its mark."""
    return artifact.removesuffix("?")


def makers(order: tuple[Stage, ...]) -> dict[str, str]:
    """Stage that writes each artifact; raises ValueError if two write the same, or one is read too early."""
    stage_of_artifact: dict[str, str] = {}
    for stage in order:
        for artifact in stage.reads:
            if without_mark(artifact) not in stage_of_artifact and not is_optional(artifact):
                raise ValueError(f"{stage.name} reads {artifact}, which no earlier stage writes")
        for artifact in map(without_mark, stage.leaves):
            if artifact in stage_of_artifact:
                raise ValueError(f"{artifact} is written by {stage_of_artifact[artifact]} and by {stage.name}")
            stage_of_artifact[artifact] = stage.name
    return stage_of_artifact


def needed_for(target: str, order: tuple[Stage, ...]) -> tuple[Stage, ...]:
    """A stage and all stages that it depends on, in order."""
    maker = makers(order)
    wanted = {target}
    for stage in reversed(order):
        if stage.name in wanted:
            wanted.update(maker[name] for name in map(without_mark, stage.reads) if name in maker)
    return tuple(stage for stage in order if stage.name in wanted)
