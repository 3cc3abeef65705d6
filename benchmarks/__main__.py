"""All benchmarks one after the other, and one table of all: python -m benchmarks [NAME ...] [--smallest] [--write].

The table gives ours, the best peer, their ratio, the limit, date and machine. A peer that is not installed is
unmeasured: the limit of such a row stays open. --write adds the rows to docs/experiments/benchmark_rows.jsonl in place
of older ones of the same benchmarks, and makes docs/benchmarks.md from it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from benchmarks.collection import BENCHMARKS, Collected, collected
from benchmarks.page import kept, table, write_page


def main() -> int:
    """Run the benchmarks; returns 1 if one failed or a row does not keep its limit, else 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(BENCHMARKS)}; absent: all")
    parser.add_argument("--smallest", action="store_true", help="the smallest sizes, as the tests run them")
    parser.add_argument("--processor-time", action="store_true", help="for a busy machine: one thread, processor time")
    parser.add_argument("--write", action="store_true", help="make docs/benchmarks.md anew")
    options = parser.parse_args()
    if unknown := [name for name in options.names if name not in BENCHMARKS]:
        parser.error(f"no benchmark of the table: {', '.join(unknown)}")
    if options.write and options.smallest:
        parser.error("--write: the page holds full sizes alone")
    found = [
        collected(name, smallest=options.smallest, processor_time=options.processor_time)
        for name in options.names or BENCHMARKS
    ]
    print(f"\n{table([record for one in found for record in one.records])}")
    failed = _failures(found)
    if options.write:
        write_page(kept(), [one for one in found if one.exit_code == 0])
    return int(failed)


def _failures(found: Sequence[Collected]) -> bool:
    """Name benchmarks that ended with an error; True if there are any."""
    failed = [one for one in found if one.exit_code]
    for one in failed:
        print(f"{one.name}: FAILED with exit code {one.exit_code}; its rows are incomplete")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
