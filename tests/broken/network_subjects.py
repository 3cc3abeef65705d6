"""Files of photogrammetric programs to damage: those of the how-to pages, and a COLMAP model in bytes."""

from __future__ import annotations

from functools import cache

from tests.broken.subjects import Subject
from tests.docs.how_to_pages import FOLDER, examples
from tests.formats.colmap_files import binary

_COLMAP = """[campaign]
name = "c"
kind = "photogrammetry"
[noise]
image_px = 0.1
point_mm = 0.1
"""
_RAYS = '[files.image_points]\npath = "images.bin"\nconstants = { pose = 1 }\n[files.cameras]\npath = "cameras.bin"\n'
_POINTS = '[files.points]\npath = "points3D.bin"\nconstants = { pose = 1, body = "b" }\n'
_PAGES = {
    "network-colmap": ("colmap", 0),
    "network-photomodeler": ("photomodeler", 0),
    "network-aicon": ("aicon", 1),
    "network-metashape": ("metashape", 1),
    "network-gsi": ("leica-gsi", 0),
}


@cache
def network_files(campaign: str) -> dict[str, bytes]:
    """The files of a campaign by name."""
    if campaign in _PAGES:
        page, number = _PAGES[campaign]
        return {name: text.encode() for name, text in examples(FOLDER / f"{page}.md")[number].files.items()}
    toml = _COLMAP + (_RAYS if campaign == "network-rays" else _POINTS)
    return {"campaign.toml": toml.encode(), **{f"{name}.bin": content for name, content in binary().items()}}


NETWORKS = (
    *(Subject("network-rays", f"{name}.bin", "bytes") for name in ("images", "cameras")),
    *(Subject("network-points", f"{name}.bin", "bytes") for name in ("points3D", "images", "cameras")),
    *(Subject("network-colmap", f"{name}.txt", "bytes") for name in ("images", "cameras")),
    *(Subject("network-aicon", f"stand.{name}", "csv") for name in ("phc", "ior", "eor", "scale")),
    Subject("network-photomodeler", "export.txt", "csv"),
    Subject("network-metashape", "markers.xml", "bytes"),
    Subject("network-gsi", "pose_1.gsi", "csv"),
)
