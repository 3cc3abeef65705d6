"""`truing power` of causes that rays show: drawn with the network of the campaign's own run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.artifacts import Unreadable, read_artifact
from truing.pipeline.campaign_folder import CampaignFolder
from truing.pipeline.power_of_photographs import OfPhotographs
from truing.schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.stages.simulated_campaigns.plan import RayPlan


def wants_rays(causes: Sequence[str], campaign: CampaignFolder) -> bool:
    """Whether causes are asked for that rays show; raises CampaignFaults where others are asked for beside them."""
    if not campaign.has_photographs:
        return False
    known = names_of_rays()
    own = [name for name in causes if name in known]
    others = [name for name in causes if name not in known]
    if own and others:
        expected = f"causes that rays show ({', '.join(known)}) in a call of their own"
        raise CampaignFaults([Fault("--causes", expected, value=", ".join(others))])
    return bool(own)


def names_of_rays() -> list[str]:
    """The ids of the causes that rays show."""
    from truing.simulation.catalogue import catalogue_of_rays

    return [name for name, kind in catalogue_of_rays().items() if kind.catalogued]


def plan_of_rays(run: Path, settings: Campaign) -> RayPlan:
    """The network of the run in a folder; raises CampaignFaults where it has left none."""
    from truing.schemas.artifacts import ARTIFACTS
    from truing.stages import power
    from truing.stages.simulated_campaigns.plan import NEEDS

    tables: dict[str, pa.Table] = {}
    for name in NEEDS:
        try:
            table = read_artifact(run, ARTIFACTS[name])
        except Unreadable:
            continue
        if not isinstance(table, str):
            tables[name] = table
    try:
        return power.ray_plan_of(tables, settings)
    except ValueError as why:
        expected = f"a run of the campaign, from whose network rays can be drawn ({why}): truing run"
        raise CampaignFaults([Fault(run.as_posix(), expected)]) from None


def said_of_rays(run: Path) -> OfPhotographs:
    """The sentence that says what is drawn."""
    return OfPhotographs(
        f"Rays are drawn, not photographs: with the network, the noise and the cameras of the run in {run.as_posix()}, "
        "as small departures from these. What an effect does to the machine's points is not looked at."
    )
