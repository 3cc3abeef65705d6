"""The cameras that a plan is made for: as a campaign names them, as a run adjusted them, as photographs tell them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.artifacts import Unreadable, read_artifact
from pipeline.campaign_folder import CampaignFolder, run_folder_of
from schemas.artifacts import ARTIFACTS
from schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class KnownCameras:
    """Cameras, a row per parameter as in cameras_given; by camera the noise of an image coordinate in px, where a run
    found it; and where all that is from, in words."""

    table: pa.Table | None
    noise_px: Mapping[str, float] = field(default_factory=dict)
    said: str = ""


def known_cameras(campaign: CampaignFolder, given: pa.Table | None, run: Path | None) -> KnownCameras:
    """Those of a run that is named, else those of campaign.toml, else of the campaign's own run, else of its pictures.

    Raises CampaignFaults where the run that is named has none.
    """
    if given is not None and run is None:
        return KnownCameras(given)
    found = _adjusted(run or run_folder_of(campaign, None, several=False))
    if found is None and run is not None:
        expected = f"a run that adjusted photographs, with {ARTIFACTS['cameras'].file}"
        raise CampaignFaults([Fault("--run", expected, value=str(run))])
    return found or _of_pictures(campaign) or KnownCameras(None)


def _adjusted(run: Path) -> KnownCameras | None:
    """The cameras of a run as it adjusted them; what it calibrated would be calibrated again."""
    try:
        cameras = read_artifact(run, ARTIFACTS["cameras"])
        rays = read_artifact(run, ARTIFACTS["image_residuals"])
    except Unreadable:
        return None
    if isinstance(cameras, str) or isinstance(rays, str):
        return None
    kept = rays.to_pandas().query("not rejected")
    noise = kept.groupby("camera")[["sigma_x_px", "sigma_y_px"]].median().mean(axis=1)
    names = list(dict.fromkeys(cameras.column("camera").to_pylist()))
    what = f"camera {names[0]}" if len(names) == 1 else f"cameras {', '.join(names)}"
    return KnownCameras(cameras, noise.to_dict(), f"With {what} as adjusted in {run.as_posix()}.")


def _of_pictures(campaign: CampaignFolder) -> KnownCameras | None:
    """The cameras that the heads of a campaign's photographs tell of: format and principal distance."""
    from stages.image_tables.cameras_beforehand import cameras_table
    from truing.estimation.bundle.camera import PARAMETERS
    from truing.formats.faultlog import FaultLog
    from truing.formats.photographs import list_photographs
    from truing.formats.source import CampaignFiles

    settings, log = campaign.validated(), FaultLog()
    source = CampaignFiles(campaign.folder, settings)
    rows: dict[str, dict[str, Any]] = {}
    for one in list_photographs(source, settings.photographs.sensor_width_mm, log).found:
        if one.head.principal_distance_px is not None:
            head = {"width_px": one.head.width_px, "height_px": one.head.height_px}
            rows.setdefault(one.camera, {**head, "focal_px": one.head.principal_distance_px, "free": PARAMETERS})
    if not rows:
        return None
    return KnownCameras(
        cameras_table(rows), said=f"With {', '.join(rows)} as the photographs' files tell, not calibrated."
    )
