"""Faults of a bench's tables."""

from __future__ import annotations

from tests.broken.spoiling import (
    Broken,
    both,
    cell,
    cells,
    every,
    replaced,
    scaled,
    whole,
    without,
    without_column,
)
from truing.pipeline.problems import ExitCode

_LOG, _SIGNALS = "interferometer.csv", "signals.csv"


def _run(number: str) -> object:
    return lambda row: row["run"] == number


CASES = (
    Broken("log-empty", "bench", whole(_LOG, b""), (_LOG,)),
    Broken("log-without-readings", "bench", without_column(_LOG, "reading"), ("reading",)),
    Broken("load-beyond-range", "bench", cell(_LOG, 3, "load", "123456"), ("load", "123456", "fx_n|10000")),
    Broken("load-axis-unknown", "bench", cell(_LOG, 3, "load_axis", "fq"), ("load_axis", "fq")),
    Broken("channel-unknown", "bench", cell(_LOG, 3, "channel", "dq"), ("channel", "dq")),
    Broken("channel-twice", "bench", cell(_LOG, 3, "step", "2"), ("step", "channel")),
    Broken("reading-a-word", "bench", cell(_LOG, 3, "reading", "overrange"), ("reading", "overrange")),
    Broken("reading-of-kilometres", "bench", cell(_LOG, 3, "reading", "1e12"), ("reading", "less than a metre")),
    Broken("time-goes-back", "bench", cell(_LOG, 5, "time_s", "-500.0"), ("time_s",)),
    Broken("run-without-number", "bench", cell(_LOG, 5, "run", ""), ("run",)),
    Broken("loads-disagree", "bench", cell(_SIGNALS, 3, "load", "-4321"), ("load", "4321")),
    Broken("signal-absent", "bench", without_column(_SIGNALS, "v4_mv"), ("without a gap",)),
    Broken(
        "air-in-kelvin",
        "bench",
        cells(_LOG, "air_temperature_c", lambda text: repr(float(text) + 273.15), every),
        ("surroundings|temperature",),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "sign-flipped-in-a-run",
        "bench",
        cells(_LOG, "reading", scaled(-1.0), _run("1")),
        ("sign", "run 1"),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "millimetres-for-micrometres",
        "bench",
        cells(_LOG, "reading", scaled(1e-3), _run("1")),
        ("unit|1000", "dx"),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "signal-saturated",
        "bench",
        cells(_SIGNALS, "v3_mv", lambda text: repr(max(-2.0, min(2.0, float(text)))), every),
        ("saturated", "v3"),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "signal-repeats-another",
        "bench",
        lambda folder: _copied(folder),
        ("signals-independent|independent",),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "most-steps-missing",
        "bench",
        without(_LOG, lambda row: int(row["step"]) % 2 == 1 and int(row["step"]) > 1),
        ("completeness channel dx",),
        ExitCode.FAILED_CHECK,
    ),
    Broken(
        "loads-of-both-forms",
        "bench",
        both(replaced(_LOG, "reading,", "reading,fx_n,"), lambda folder: _widened(folder)),
        ("load",),
    ),
    Broken(
        "not-compensated-and-no-air",
        "bench",
        both(
            replaced("campaign.toml", "compensated = true", "compensated = false"),
            without_column(_LOG, "air_pressure_hpa"),
        ),
        ("air_pressure_hpa",),
    ),
)


def _copied(folder: object) -> None:
    path = folder / _SIGNALS  # type: ignore[operator]
    head, *rows = (line.split(",") for line in path.read_text().splitlines())
    for row in rows:
        row[head.index("v2_mv")] = row[head.index("v1_mv")]
    path.write_text("".join(",".join(row) + "\n" for row in (head, *rows)))


def _widened(folder: object) -> None:
    path = folder / _LOG  # type: ignore[operator]
    head, *rows = path.read_text().splitlines()
    place = head.split(",").index("fx_n")
    wide = [",".join([*row.split(",")[:place], "0", *row.split(",")[place:]]) for row in rows]
    path.write_text("\n".join([head, *wide]) + "\n")
