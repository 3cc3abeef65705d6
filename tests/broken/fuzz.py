"""Damage good campaigns at random for a while: ``python -m tests.broken.fuzz --minutes 10 [--seed 1] [--only NAME]``.

Every kind of misbehaviour is reported once; the campaign that shows it is kept in ``--keep``.
"""

from __future__ import annotations

import argparse
import faulthandler
import re
import resource
import sys
import tempfile
import time
import warnings
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from tests.broken.more_subjects import MORE, more_files
from tests.broken.oracle import contents, lay_out, misbehaviour
from tests.broken.subjects import SUBJECTS, Subject

_AT_A_TIME = 100
_MEMORY = 6 << 30
_HANGS = 120  # seconds on one campaign, after which the call ends with a traceback


def main() -> int:
    """Fuzz for the given minutes of the processor; returns how many kinds of misbehaviour were seen."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--minutes", type=float, default=1.0)
    words.add_argument("--seed", type=int, default=1)
    words.add_argument("--only", default="", help="part of a subject's name: telescope/points.csv")
    words.add_argument("--each", type=int, default=_AT_A_TIME, help="campaigns of a subject, one after the other")
    words.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "truing-fuzz")
    given_words = words.parse_args()
    warnings.simplefilter("error")
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    subjects = [subject for subject in (*SUBJECTS, *MORE) if given_words.only in subject.name]
    seen: dict[str, str] = {}
    tried, number = 0, given_words.seed
    while time.process_time() < 60.0 * given_words.minutes:
        for subject in subjects:
            tried += _rounds(subject, number, given_words, seen)
        number += 1
    sys.stdout.write(f"{tried} campaigns, {len(seen)} kinds of misbehaviour, {_peak_mb()} MB at most\n")
    return len(seen)


def _rounds(subject: Subject, number: int, wish: argparse.Namespace, seen: dict[str, str]) -> int:
    profile = settings(
        max_examples=wish.each,
        phases=[Phase.generate],
        database=None,
        derandomize=False,
        suppress_health_check=list(HealthCheck),
    )
    tried = 0

    @seed(number)
    @profile
    @given(content=contents(subject, more_files) | st.binary(max_size=300))
    def one(content: bytes) -> None:
        nonlocal tried
        tried += 1
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "c"
            folder.mkdir()
            lay_out(subject, folder, content, more_files)
            faulthandler.dump_traceback_later(_HANGS, exit=True)
            before = _peak_mb()
            wrong = misbehaviour(folder, subject.command)
            faulthandler.cancel_dump_traceback_later()
            if _peak_mb() > before + 500:
                wrong = wrong or f"memory grew to {_peak_mb()} MB"
        if wrong and (kind := _kind(wrong)) not in seen:
            seen[kind] = wrong
            kept = wish.keep / f"{len(seen)}-{re.sub('[/ ]', '-', subject.name)}"
            kept.mkdir(parents=True, exist_ok=True)
            lay_out(subject, kept, content, more_files)
            sys.stdout.write(f"== {kept}\n{_end(wrong)}\n")
            sys.stdout.flush()

    one()
    return tried


def _kind(wrong: str) -> str:
    """Key of a misbehaviour: the innermost frame of the traceback, else the words without numbers."""
    places = re.findall(r'File "([^"]+)", line (\d+)', wrong)
    own = [place for place in places if "site-packages" not in place[0]]
    return str(own[-1:] or re.sub(r"\d+|'.*?'", "", wrong)[:60])


def _end(wrong: str) -> str:
    """The last lines, each of a length that can be read."""
    return "\n".join(line[:300] for line in wrong.splitlines()[-14:])


def _peak_mb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


if __name__ == "__main__":
    sys.exit(main() > 0)
