"""`truing export`: a run's results in the forms that others read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.problems import ExitCode, environment
from truing.pipeline.recorded import broken_run, opened_run
from truing.pipeline.voice import Voice
from truing.pipeline.whole_file import write_whole
from truing.pipeline.written_places import check_folder
from truing.schemas.certificate import Certificate
from truing.schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    from truing.runs.recorded_run import Run

FORMS = ("csv", "xlsx", "json", "controller")
CERTIFICATE = "dcc"  # by itself alone: it needs more than a run
FOLDER = "exports"
_FILE = "campaign.toml"


def export_run(folder: Path, forms: tuple[str, ...], out: Path | None, campaign: Path | None = None) -> ExitCode:
    """Write the forms into a folder, one file after the other, each whole; raises CampaignFaults.

    A certificate takes what no measurement tells from the campaign's folder, and is refused where a check failed.
    """
    known = (*FORMS, CERTIFICATE)
    unknown = [form for form in forms if form not in known]
    if unknown:
        raise CampaignFaults(Fault("--to", f"one of {', '.join(known)}", value=form) for form in unknown)
    run, place = opened_run(folder), out or folder / FOLDER
    check_folder(place)
    with environment(f"the folder {place} cannot be made"):
        place.mkdir(parents=True, exist_ok=True)
    voice = Voice(quiet=False)
    for form in forms or FORMS:
        try:
            written = [_write(place, name, content) for name, content in _files(form, run, campaign)]
        except NoCertificate as why:
            voice.warn(str(why))
            return ExitCode.FAILED_CHECK
        voice.say(f"{form}: {_said(place, written)}")
    return ExitCode.DONE


def _files(form: str, run: Run, campaign: Path | None) -> Iterable[tuple[str, bytes]]:
    from truing.runs.exports.controller import controller
    from truing.runs.exports.summary import summary
    from truing.runs.exports.text_tables import text_tables
    from truing.runs.exports.workbook import workbook

    def of_campaign(run: Run) -> Iterable[tuple[str, bytes]]:
        return certificate_files(run, campaign)

    makers = {CERTIFICATE: of_campaign, "csv": text_tables, "xlsx": workbook, "json": summary, "controller": controller}
    try:
        yield from makers[form](run)
    except ValueError as broken:  # a file of the run is not what its schema says
        raise CampaignFaults(broken_run(run.folder, broken)) from None


def _write(place: Path, name: str, content: bytes) -> str:
    write_whole(place / name, content)
    return name


def _said(place: Path, written: list[str]) -> str:
    if not written:
        return "nothing, for the run has left no extended model"
    return f"{place / written[0]}" if len(written) == 1 else f"{len(written)} files in {place}"


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
