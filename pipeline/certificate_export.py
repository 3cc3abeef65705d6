"""What `truing export --to dcc` asks of a run and of a campaign before it writes a certificate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.campaign_folder import open_campaign
from schemas.certificate import Certificate
from schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    from truing.runs.recorded_run import Run

_FILE = "campaign.toml"


class NoCertificate(Exception):
    """The run may not be certified, because checks of its quality failed."""


def certificate_files(run: Run, campaign: Path | None) -> Iterable[tuple[str, bytes]]:
    """The certificate; raises NoCertificate where a check failed, CampaignFaults with all that is missing at once."""
    from truing.runs.exports.certificate.document import certificate
    from truing.runs.exports.certificate.qualified import failed_checks, qualified, temperature

    if campaign is None:
        raise CampaignFaults([Fault("--campaign", "the campaign's folder, whose campaign.toml has [certificate]")])
    settings = open_campaign(campaign).validated()
    if settings.campaign.name != run.campaign:
        raise CampaignFaults([Fault("--campaign", f"the campaign {run.campaign}", value=settings.campaign.name)])
    if failed := failed_checks(run):
        raise NoCertificate(f"no certificate: failed checks of quality, accepted by nobody: {', '.join(failed)}")
    if "uncertainty" not in run or not len(qualified(run).results):
        wanted = "results with an uncertainty, which a certificate needs; `truing run` says why there are none"
        raise CampaignFaults([Fault(str(run.folder), wanted)])
    if faults := list(_faults(settings.certificate, temperature(run) is not None)):
        raise CampaignFaults(faults)
    return certificate(run, settings.certificate)


def _faults(told: Certificate, temperature_known: bool) -> Iterator[Fault]:
    missing = told.missing(temperature_known=temperature_known)
    yield from (Fault(_FILE, "this key to be present, for a certificate", column=key) for key in missing)
    if told.begin is not None and told.end is not None and told.end < told.begin:
        yield Fault(_FILE, "a day not before certificate.begin", column="certificate.end", value=str(told.end))
