"""`truing report`: the verdict of a run and its page; as PDF through a browser of this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from truing.child_processes import child_environment
from truing.pipeline.artifacts import table_of
from truing.pipeline.atomic_file import write_atomically
from truing.pipeline.campaign_folder import suggested_folder
from truing.pipeline.campaign_run import verdict_line
from truing.pipeline.console import RunConsole
from truing.pipeline.problems import EnvironmentProblem, ExitCode, environment
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.verdict import CAMPAIGN

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
EVERYTHING = "everything"  # fragment of the page's address by which its script opens the appendix
_PATIENCE_S = 300.0
_FLAGS = (
    *("--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-extensions"),
    *("--disable-dev-shm-usage", "--no-pdf-header-footer", "--enable-unsafe-swiftshader"),
)


def report_run(folder: Path, *, as_pdf: bool, everything: bool, out: Path | None, console: RunConsole) -> ExitCode:
    """Print the verdict of a run and the path of its page, and with ``as_pdf`` print the page to a PDF file.

    ``everything``: with the appendix. Raises CampaignFaults without a page, EnvironmentProblem without a browser.
    """
    page, target = folder / ARTIFACTS["report"].file, out or folder / "report.pdf"
    if not page.is_file():
        raise CampaignFaults(
            [Fault(str(folder), f"a folder with {page.name}, which `truing run` writes{suggested_folder(folder)}")]
        )
    if as_pdf and (target.suffix.lower() != ".pdf" or target.is_dir()):
        raise CampaignFaults([Fault("--out", "a file that ends in .pdf", value=str(target))])
    if as_pdf:
        write_atomically(target, printed(page, everything=everything))
    verdict = table_of(folder, "verdict")
    for row in () if verdict is None else verdict.to_pylist():
        console.add_fact("verdicts", row)
        if row["section"] == CAMPAIGN:
            console.line(verdict_line(row))
    console.add_fact("files", {"file": str(page)})
    console.line(f"report: {page}")
    if as_pdf:
        console.add_fact("files", {"file": str(target)})
        console.line(f"pdf: {target}")
    return ExitCode.DONE


def printed(page: Path, *, everything: bool = False) -> bytes:
    """The page as PDF; raises EnvironmentProblem without a browser, or if it fails."""
    program = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if program is None:
        raise EnvironmentProblem(
            f"no browser prints the page: none of {', '.join(BROWSERS)} is on PATH; install Chromium or Google Chrome, "
            f"or open {page} in any browser and print it"
        )
    address = page.resolve().as_uri() + (f"#{EVERYTHING}" if everything else "")
    with environment("the page cannot be printed"), tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        made = Path(scratch, "page.pdf")
        _call([program, *_FLAGS, *_alone(), f"--user-data-dir={scratch}", f"--print-to-pdf={made}", address])
        content = made.read_bytes() if made.is_file() else b""
    if not content.startswith(b"%PDF"):
        raise EnvironmentProblem(f"{program} wrote no PDF; open {page} in it and print from there")
    return content


def _alone() -> tuple[str, ...]:
    """The flag without which Chromium refuses to start for the user root, as in a container."""
    return ("--no-sandbox",) if hasattr(os, "geteuid") and os.geteuid() == 0 else ()


def _call(words: list[str]) -> None:
    try:
        done = subprocess.run(words, env=child_environment(), capture_output=True, check=False, timeout=_PATIENCE_S)
    except subprocess.TimeoutExpired:
        raise EnvironmentProblem(f"{words[0]} did not print the page within {_PATIENCE_S:.0f} s") from None
    if done.returncode:
        last = (done.stderr.decode(errors="replace").splitlines() or ["without a message"])[-1][:200]
        raise EnvironmentProblem(f"{words[0]} ended with code {done.returncode}: {last}")
