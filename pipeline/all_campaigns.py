"""One table and one page of all campaigns of a call, the worst first."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from truing.pipeline.atomic_file import write_atomically
from truing.pipeline.campaign_outcome import CampaignOutcome
from truing.pipeline.manifest import digest_of
from truing.pipeline.problems import gravity
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.arrays import TableRow

_TABLE = ARTIFACTS["campaigns"]
PAGE = "campaigns.html"
# States of verdicts, the best first; a campaign without one lies between.
_STATES = ("ok", "not tested", None, "attention", "fails")
_STAGE = "run"


def check_shared_folder(folder: Path) -> None:
    """Raise CampaignFaults if a folder holds a campaign, or files of another origin under the names of these."""
    from truing.pipeline.artifacts import read_provenance
    from truing.pipeline.given_files import check_folder

    check_folder(folder)
    present = [name for name in (_TABLE.file, PAGE) if os.path.lexists(folder / name)]
    provenance = read_provenance(folder, _TABLE) if present else None
    if present and (provenance or {}).get("stage") != _STAGE:
        expected = f"a folder without files of another origin ({', '.join(present)})"
        raise CampaignFaults([Fault("--out", expected, value=str(folder))])


def write_all_campaigns(folder: Path, ends: Sequence[tuple[Path, CampaignOutcome]]) -> tuple[Path, Path]:
    """Write table and page of all campaigns into a folder; returns both paths. Raises EnvironmentProblem."""
    from truing import __version__
    from truing.pipeline.artifacts import Stamp, write_table
    from truing.report.all_campaigns import campaigns_page

    table = campaigns_table(ends)
    digest = digest_of([str(path) for path, _ in ends])
    names = f"{len(ends)} campaigns"
    write_table(folder / _TABLE.file, _TABLE, table, Stamp(_STAGE, digest, names, __version__, (_TABLE.name,)))
    rows = table.to_pylist()
    page = campaigns_page(rows, [_link(row["run_folder"], folder) for row in rows])
    write_atomically(folder / PAGE, page.encode())
    return folder / _TABLE.file, folder / PAGE


def campaigns_table(ends: Sequence[tuple[Path, CampaignOutcome]]) -> pa.Table:
    """The table ``campaigns``: one row per campaign, the worst first."""
    import pyarrow as pa

    rows = sorted((_row(path, outcome) for path, outcome in ends), key=_badness)
    ranked = [{"rank": rank, **row} for rank, row in enumerate(rows, start=1)]
    return pa.Table.from_pylist(ranked, schema=_TABLE.arrow_schema())


def _badness(row: TableRow) -> tuple[int, int, str, str]:
    state = _STATES.index(row["campaign_state"])
    return -gravity(row["exit_code"]), -state, row["campaign"], row["campaign_path"]


def _row(path: Path, outcome: CampaignOutcome) -> TableRow:
    run = next((fact for kind, fact in outcome.facts if kind == "campaigns"), {})
    verdict = run.get("verdict") or {}
    return {
        "campaign": run.get("campaign", str(path)),
        "campaign_path": str(path),
        "campaign_state": verdict.get("state"),
        "decided_by": verdict.get("decided_by") or None,
        "explanation": verdict.get("explanation", ""),
        "exit_code": int(outcome.code),
        "failed_checks": ", ".join(run.get("failed_checks", ())) or None,
        "problems": len(outcome.problems),
        "problem": next((" ".join(text.split()) for text in outcome.problems), None),
        "run_folder": run.get("folder"),
        "stages_run": sum(stage["ran"] for stage in run.get("stages", ())),
        "processor_s": outcome.processor_s,
    }


def _link(run_folder: str | None, folder: Path) -> str:
    """Address of a run's report from the page in ``folder``; empty if there is none."""
    report = Path(run_folder or "") / ARTIFACTS["report"].file
    if run_folder is None or not report.is_file():
        return ""
    try:
        return quote(Path(os.path.relpath(report, folder)).as_posix())
    except ValueError:  # on another drive
        return report.resolve().as_uri()
