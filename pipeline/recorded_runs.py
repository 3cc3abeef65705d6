"""`truing export` and `truing compare`: commands that read finished runs."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from truing import __version__
from truing.pipeline.all_campaigns import PAGE as CAMPAIGNS_PAGE
from truing.pipeline.artifacts import Stamp, write_table
from truing.pipeline.atomic_file import write_atomically
from truing.pipeline.campaign_folder import open_campaign, suggested_folder
from truing.pipeline.completions import ALL_FORMS, CERTIFICATE, FORMS, ROBOT
from truing.pipeline.console import RunConsole
from truing.pipeline.given_files import check_folder
from truing.pipeline.manifest import DigestCache, Manifest, read_manifest
from truing.pipeline.problems import ExitCode, environment
from truing.pipeline.run_folder import PRIVATE
from truing.report.comparison.compared_runs import ComparedRun, RunComparison, RunTransition
from truing.report.comparison.page import comparison_head, comparison_sections
from truing.report.glossary_section import with_reference
from truing.report.rendering.render import render_page
from truing.report.verdict import gates
from truing.runs.comparison.side_by_side import SideBySide, compared_table, kind_of, mechanism_of, side_by_side
from truing.runs.exports.certificate import certificate, doubts, failed_checks, temperature, valid_results
from truing.runs.exports.controller import controller
from truing.runs.exports.robot_description import urdf
from truing.runs.exports.summary import summary
from truing.runs.exports.tables import text_tables, workbook
from truing.runs.recorded_run import Run, load
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.certificate import Certificate
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.near_names import did_you_mean

_PAGE = ARTIFACTS["report"].file
_AGAIN = "`truing run` writes it again"

_EXPORTS = "exports"
_FILE = "campaign.toml"

_COMPARISON, PAGE = "comparison", "comparison.html"
_OF_SEVERAL_RUNS = (_COMPARISON, ARTIFACTS["campaigns"].file, CAMPAIGNS_PAGE)
_MEASURED = ("observations", "readings")
# Artifacts that the page uses besides the compared numbers.
_SHOWN = ("qa", "diagnosis", "model_choice", "requirements", "error_classes")


def opened_run(folder: Path) -> Run:
    """Open a run; raises CampaignFaults if it is missing or its files do not come from the same run."""
    try:
        run = load(folder)
    except (FileNotFoundError, NotADirectoryError):
        raise CampaignFaults(
            [Fault(str(folder), f"a folder that `truing run` has filled{suggested_folder(folder)}")]
        ) from None
    except ValueError as broken:
        raise CampaignFaults(_broken_run(folder, broken)) from None
    manifest = read_manifest(folder / PRIVATE / "ledger.json")  # empty if only the tables were copied
    if faults := [*_changed(folder, manifest), *_mixed(folder, manifest)]:
        raise CampaignFaults(faults)
    try:
        run.model  # noqa: B018 (read once, here, so that its faults are the run's)
    except (OSError, ValueError, RecursionError):
        raise CampaignFaults([Fault(str(folder), "a model.toml that `truing run` has written")]) from None
    return run


def _broken_run(folder: Path, broken: Exception) -> list[Fault]:
    """Faults of a run with unreadable files or files that contradict their schema, one per line."""
    return [Fault(str(folder), f"an intact run ({line})") for line in str(broken).split("\n")]


def _changed(folder: Path, manifest: Manifest) -> Iterator[Fault]:
    """One fault per file that changed after its stage wrote it."""
    digests = DigestCache(None)
    for entry in manifest.entries.values():
        for name, digest in entry.artifacts.items():
            file = ARTIFACTS[name].file if name in ARTIFACTS else _PAGE
            try:
                if file != _PAGE and digests.digest(folder / file) != digest:
                    yield Fault(str(folder / file), f"the file unchanged since its stage wrote it; {_AGAIN}")
            except FileNotFoundError:
                yield Fault(str(folder / file), f"this file, which its stage wrote; {_AGAIN}")


def _mixed(folder: Path, manifest: Manifest) -> Iterator[Fault]:
    """One fault per stage that was made from other tables than the present ones, because a run did not finish."""
    there = {name: digest for entry in manifest.entries.values() for name, digest in entry.artifacts.items()}
    for stage, entry in manifest.entries.items():
        inputs = {} if entry.made_from is None else entry.made_from.inputs
        if any(there.get(name) != digest for name, digest in inputs.items()):
            yield Fault(str(folder), f"a complete run; {stage} was made from other tables than these, {_AGAIN}")


def export_run(
    folder: Path, forms: tuple[str, ...], out: Path | None, console: RunConsole, campaign: Path | None = None
) -> ExitCode:
    """Write the formats into a folder, each file atomically; raises CampaignFaults.

    A certificate takes its other entries from the campaign's folder. It is refused if a check failed, or if all of its
    results depend on a model that fails.
    """
    unknown = [form for form in forms if form not in ALL_FORMS]
    if unknown:
        formats_text = ", ".join(ALL_FORMS)
        raise CampaignFaults(
            Fault("--to", f"one of {formats_text}{did_you_mean(form, ALL_FORMS)}", value=form) for form in unknown
        )
    run, target = opened_run(folder), out or folder / _EXPORTS
    check_folder(target)
    with environment(f"the folder {target} cannot be created"):
        target.mkdir(parents=True, exist_ok=True)
    for form in forms or FORMS:
        try:
            written = [_write(target, name, content) for name, content in _files(form, run, campaign)]
        except _NoCertificate as why:
            console.warn(str(why))
            return ExitCode.FAILED_CHECK
        console.line(f"{form}: {_exported_files_text(target, written)}")
        for name in written:
            console.add_fact("files", {"form": form, "file": str(target / name)})
        for left_out in valid_results(run).left_out if form == CERTIFICATE else ():
            console.warn(f"not certified: {left_out}")
    return ExitCode.DONE


def _files(form: str, run: Run, campaign: Path | None) -> Iterable[tuple[str, bytes]]:
    def of_campaign(run: Run) -> Iterable[tuple[str, bytes]]:
        return certificate_files(run, campaign)

    makers = {
        CERTIFICATE: of_campaign,
        "csv": text_tables,
        "xlsx": workbook,
        "json": summary,
        "controller": controller,
        ROBOT: urdf,
    }
    try:
        yield from makers[form](run)
    except ValueError as broken:  # a file of the run contradicts its schema
        raise CampaignFaults(_broken_run(run.folder, broken)) from None


def _write(path: Path, name: str, content: bytes) -> str:
    write_atomically(path / name, content)
    return name


def _exported_files_text(target: Path, written: list[str]) -> str:
    if not written:
        return "nothing, because the run has no extended model"
    return f"{target / written[0]}" if len(written) == 1 else f"{len(written)} files in {target}"


class _NoCertificate(Exception):
    """The run cannot be certified, because its data or the model of its results fail."""


def certificate_files(run: Run, campaign: Path | None) -> Iterable[tuple[str, bytes]]:
    """The certificate; raises NoCertificate if data or model fail, CampaignFaults with all missing entries."""
    if campaign is None:
        raise CampaignFaults([Fault("--campaign", "the campaign's folder, whose campaign.toml has [certificate]")])
    settings = open_campaign(campaign).validated()
    if settings.campaign.name != run.campaign:
        raise CampaignFaults([Fault("--campaign", f"the campaign {run.campaign}", value=settings.campaign.name)])
    if failed := failed_checks(run):
        raise _NoCertificate(f"no certificate: quality checks failed and were not accepted: {', '.join(failed)}")
    if failed := gates(run.verdict.to_dict("records")):
        raise _NoCertificate(
            f"no certificate: sections of the report fail ({', '.join(failed)}): see the report of the run"
        )
    found = valid_results(run) if "uncertainty" in run else None
    if found is not None and not len(found.results) and found.left_out and doubts(run):
        raise _NoCertificate(f"no certificate: {' '.join(found.left_out)}")
    if found is None or not len(found.results):
        wanted = (
            "results with an uncertainty, which a certificate needs; `truing run` gives the reason for their absence"
        )
        raise CampaignFaults([Fault(str(run.folder), wanted)])
    if faults := list(_faults(settings.certificate, temperature(run) is not None)):
        raise CampaignFaults(faults)
    return certificate(run, settings.certificate)


def _faults(document: Certificate, temperature_known: bool) -> Iterator[Fault]:
    missing = document.missing(temperature_known=temperature_known)
    yield from (Fault(_FILE, "this key to be present, for a certificate", column=key) for key in missing)
    if document.begin is not None and document.end is not None and document.end < document.begin:
        yield Fault(_FILE, "a day on or after certificate.begin", column="certificate.end", value=str(document.end))


def compare_runs(folders: Sequence[Path], out: Path | None, console: RunConsole) -> ExitCode:
    """Write the table and the page of a comparison, and print the changes. Raises CampaignFaults."""
    folders = [folder for folder in folders if not _is_of_several_runs(folder)]
    _distinct(folders)
    target = folders[0].parent / _COMPARISON if out is None else out
    check_folder(target)
    runs = [_opened(folder) for folder in folders]
    try:
        _of_one_machine(runs)
        _check_measurements_differ(runs)
        found = side_by_side(runs)
        shown = _comparison(runs, found)
        head = comparison_head(shown)
    except (ValueError, OSError) as broken:  # a file of a run contradicts its schema, or cannot be read
        lines = str(broken).split("\n")
        raise CampaignFaults(Fault("RUN", f"intact runs ({line})") for line in lines) from None
    with environment(f"the folder {target} cannot be created"):
        target.mkdir(parents=True, exist_ok=True)
    artifact = ARTIFACTS["compared"]
    _leave_table(target / artifact.file, found, runs)
    bench = "readings" in runs[0] or "signals" in runs[0]
    sections = with_reference(comparison_sections(shown), bench=bench)
    write_atomically(target / PAGE, render_page(head, sections).encode())
    for mark, sentence in head.verdicts:
        console.add_fact("verdicts", {"mark": mark, "sentence": sentence})
        console.line(sentence)
    for row in compared_table(found).to_pylist():
        console.add_fact("compared", row)
    console.line(f"table and page: {target / artifact.file}, {target / PAGE}")
    return ExitCode.DONE


def _is_of_several_runs(path: Path) -> bool:
    """True for what truing itself writes next to run folders, which the pattern runs/* names too."""
    return path.name in _OF_SEVERAL_RUNS and (path.is_file() or (path / PAGE).is_file())


def _leave_table(path: Path, comparison: SideBySide, runs: Sequence[Run]) -> None:
    digest = _digest([run.origin("qa")["digest"] for run in runs])
    campaigns = ", ".join(dict.fromkeys(run.campaign for run in runs))
    stamp = Stamp("compare", digest, campaigns, __version__, ("compared",))
    write_table(path, ARTIFACTS["compared"], compared_table(comparison), stamp)


def _distinct(folders: Sequence[Path]) -> None:
    """Raise for fewer than two runs, or a run named twice."""
    if len(folders) < 2:
        raise CampaignFaults([Fault("RUN", "two runs or more", value=", ".join(map(str, folders)) or None)])
    twice = [path for path, times in Counter(os.path.realpath(folder) for folder in folders).items() if times > 1]
    if twice:
        raise CampaignFaults(Fault(path, "each run once") for path in twice)


def _opened(folder: Path) -> Run:
    run = opened_run(folder)
    if "qa" not in run:
        raise CampaignFaults([Fault(str(folder), "a folder that `truing run` has filled")])
    return run


def _of_one_machine(runs: Sequence[Run]) -> None:
    """Raise for runs of different mechanisms; a run without a model fits any mechanism of its tables."""
    for fact_of in (kind_of, mechanism_of):
        known = [(run, what) for run in runs if (what := fact_of(run))]
        for run, what in known[1:]:
            if what != known[0][1]:
                expected = f"runs of the machine of {known[0][0].folder}: {known[0][1]}"
                raise CampaignFaults([Fault(str(run.folder), expected, value=what)])


def _check_measurements_differ(runs: Sequence[Run]) -> None:
    """Raise for two runs of the same measurements, because they agree whatever the machine did."""
    first: dict[str, Run] = {}
    for run in runs:
        for name in _MEASURED:
            if name in run:
                same = first.setdefault(run.origin(name)["digest"], run)
                if same is not run:
                    expected = f"a run of other measurements than {same.folder}"
                    raise CampaignFaults([Fault(str(run.folder), expected)])


def _comparison(runs: Sequence[Run], comparison: SideBySide) -> RunComparison:
    compared = tuple(
        ComparedRun(
            label,
            str(run.folder),
            run.origin("qa")["software_version"],
            {name: run[name] for name in _SHOWN if name in run},
        )
        for label, run in zip(_labels(runs), runs, strict=True)
    )
    between = tuple(
        RunTransition(tuple(step.why for step in steps if step.why), any(step.rebuilt for step in steps))
        for steps in comparison.steps
    )
    return RunComparison(compared, comparison.table, between)


def _labels(runs: Sequence[Run]) -> list[str]:
    """Labels of the runs: campaign, folder or whole path, whichever distinguishes them."""
    for names in ([run.campaign for run in runs], [run.folder.name for run in runs]):
        if len(set(names)) == len(runs):
            return names
    return [str(run.folder) for run in runs]


def _digest(parts: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
