"""Tables of the blind benchmark's pages, generated from the results of ``benchmarks.blind``."""

from __future__ import annotations

import gzip
import json
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind_figures import confusion_figure, power_figure, strip_figure
from benchmarks.blind_instruments import INSTRUMENTS, Instrument
from docs.experiments.marked_tables import renew, table
from tests.blind import rates
from tests.blind.judging import Assessed, Record
from tests.blind.rates import Count

NAME = "unexplained"
POINTS = INSTRUMENTS["photogrammetry"]
CLEAR_PART = 10.0  # signal-to-noise of the part of an effect that only one input tells
FOREIGN_PAGE = POINTS.page.with_name("foreign-worlds.md")


def write_page(records: Sequence[Record], instrument: Instrument = POINTS) -> None:
    """Make tables and figures of an instrument's page anew, and keep the results that they were made from."""
    _keep(records, instrument.results)
    campaigns = kept_campaigns(instrument.results)
    renew(instrument.page, tables(campaigns, instrument))
    power_figure(instrument.figure("power"), campaigns)
    strip_figure(instrument.figure("causes"), campaigns, instrument.catalogue)
    confusion_figure(instrument.figure("confusion"), *confusion(campaigns, instrument))


def write_unforeseen(records: Sequence[Record], instrument: Instrument) -> None:
    """Renew the table of unforeseen effects, and keep its results."""
    _keep(records, instrument.unforeseen_results)
    renew(instrument.page, {"unforeseen": lambda: unforeseen(kept_campaigns(instrument.unforeseen_results))})


def write_added(records: Sequence[Record], instrument: Instrument) -> None:
    """Make the table of causes anew that joined the catalogue since the page was drawn, and keep its results."""
    _keep(records, instrument.added_results)
    renew(instrument.page, {"added": lambda: causes(kept_campaigns(instrument.added_results), instrument)})


def write_foreign(records: Sequence[Record], instrument: Instrument) -> None:
    """Make the table of worlds that nobody described anew, and keep its results."""
    _keep(records, instrument.foreign_results)
    renew(
        FOREIGN_PAGE, {f"foreign {instrument.short_name}": lambda: foreign(kept_campaigns(instrument.foreign_results))}
    )


def _keep(records: Sequence[Record], file: Path) -> None:
    lines = "".join(json.dumps(record) + "\n" for record in sorted(records, key=lambda one: one["number"]))
    file.write_bytes(gzip.compress(lines.encode(), mtime=0))


def kept_campaigns(file: Path) -> list[Assessed]:
    """Return the campaigns that a page was made from."""
    lines = gzip.decompress(file.read_bytes()).decode().splitlines()
    return [Assessed(json.loads(line)) for line in lines]


def tables(campaigns: Sequence[Assessed], instrument: Instrument = POINTS) -> dict[str, Callable[[], str]]:
    """Return the functions that build the tables of the page, by name."""
    return {
        "goals": lambda: goals(campaigns, instrument),
        "causes": lambda: causes(campaigns, instrument),
        "layouts": lambda: layouts(campaigns, instrument),
        "unknown": lambda: unknown(campaigns),
        "wrong": lambda: wrong(campaigns),
    }


def _clear(campaigns: Sequence[Assessed]) -> list[Assessed]:
    return [campaign for campaign in campaigns if not campaign.hidden or rates.is_clear(campaign)]


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if np.isfinite(share) else ""


def _of(count: Count) -> list[str]:
    low, high = rates.interval(count.good, count.trials)
    return [f"{count.good} of {count.trials}", _percent(count.share), f"{_percent(low)} to {_percent(high)}"]


def goals(campaigns: Sequence[Assessed], instrument: Instrument = POINTS) -> str:
    """Return the table of required and reached rates."""
    clear = _clear(campaigns)
    rows = [
        ["nothing hidden: something found", "at most 5 %", *_of(rates.alarms(clear))],
        ["one effect: something found", "95 %", *_of(rates.detected(clear))],
        ["named, or indistinguishable from a found cause", "90 %", *_of(rates.named(clear))],
        [f"of these: the right {instrument.subjects}", "95 %", *_of(rates.placed(clear))],
        ["two effects: both named", "75 %", *_of(rates.both_named(clear))],
        ["more found than was hidden", "", *_of(rates.invented(clear))],
        ["an effect of no catalogue: `unexplained`, with all that drives it", "80 %", *_of(rates.driven(clear))],
        ["the same: given a name", "at most 10 %", *_of(rates.misnamed(clear))],
        ["true parameters within stated 95 %", "90 to 98 %", *_mean(rates.coverage(clear))],
        ["held-out error over the noise floor", "at most 1.1", *_middle(rates.floors(clear))],
        ["share of the held-out excess over the floor that is removed", "", *_pooled(rates.excesses(clear))],
        ["pulls after the extension inside their 95 % band", "95 %", *_of(rates.pulled(clear))],
        [
            "processor seconds for a campaign",
            "20 s on 2 cores",
            *_middle(np.array([one.record["seconds"] for one in clear])),
        ],
    ]
    reported = [row for row in rows if row[2] not in ("0", "0 of 0")]
    return table(["", "asked", "campaigns", "reached", "95 % interval"], reported)


def _mean(shares: NDArray) -> list[str]:
    if len(shares) < 2:
        return [str(len(shares)), "", ""]
    off = 1.96 * shares.std(ddof=1) / np.sqrt(len(shares))
    low, high = shares.mean() - off, min(shares.mean() + off, 1.0)
    return [str(len(shares)), _percent(shares.mean()), f"{_percent(low)} to {_percent(high)}"]


def _pooled(excess: NDArray) -> list[str]:
    """Return the share of the excess of all campaigns together that is removed, its interval by the jackknife."""
    if len(excess) < 3:
        return [str(len(excess)), "", ""]
    total = excess.sum(axis=0)
    without = 1 - (total[1] - excess[:, 1]) / (total[0] - excess[:, 0])
    off = 1.96 * np.sqrt((len(excess) - 1) * np.var(without))
    share = float(1 - total[1] / total[0])
    return [str(len(excess)), _percent(share), f"{_percent(share - off)} to {_percent(share + off)}"]


def _middle(values: NDArray) -> list[str]:
    """Return the median, and where nine in ten lie."""
    if not len(values):
        return ["0", "", ""]
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return [str(len(values)), f"median {middle:.2f}", f"nine in ten: {low:.2f} to {high:.2f}"]


def causes(campaigns: Sequence[Assessed], instrument: Instrument) -> str:
    """The table of each cause that was hidden alone: what is clear, and what is too weak to be found for certain."""
    rows = []
    for cause in instrument.catalogue:
        alone = [campaign for campaign in campaigns if [effect.cause for effect in campaign.hidden] == [cause]]
        if not alone:
            continue
        clear = [one for one in alone if rates.is_clear(one)]
        weak = [one for one in alone if not rates.is_clear(one)]
        covered = rates.coverage(clear)
        shares = [
            rates.detected(clear),
            rates.named(clear),
            rates.placed(clear),
            rates.detected(weak),
            rates.named(weak),
        ]
        cells = [f"{share.good} of {share.trials}" if share.trials else "" for share in shares]
        rows.append([f"`{cause}`", *cells[:3], _percent(covered.mean()) if len(covered) else "", *cells[3:]])
    heads = [
        "cause",
        "found",
        "named",
        f"right {instrument.subjects}",
        "truth within 95 %",
        "weak: found",
        "weak: named",
    ]
    return table(heads, rows)


def layouts(campaigns: Sequence[Assessed], instrument: Instrument) -> str:
    """Return the table of each layout."""
    rows = []
    for kind in instrument.layouts:
        there = [one for one in _clear(campaigns) if one.record["truth"]["layout"] == kind]
        assessed = (rates.alarms, rates.detected, rates.named, rates.placed, rates.both_named)
        shares = [judge(there) for judge in assessed]
        rows.append([kind, *(f"{share.good} of {share.trials}" if share.trials else "" for share in shares)])
    heads = ["layout", "false alarms", "found", "named", f"right {instrument.subjects}", "both of two named"]
    return table(heads, rows)


def unknown(campaigns: Sequence[Assessed]) -> str:
    """Return the table of effects in no catalogue."""
    strange = [campaign for campaign in campaigns if campaign.hidden and campaign.hidden[0].cause == NAME]
    rows = []
    for kind in sorted({one.hidden[0].kind for one in strange}):
        own = [one for one in strange if one.hidden[0].kind == kind]
        driven, misnamed = rates.driven(own), rates.misnamed(own)
        names = Counter(name for one in own for name in sorted(set(one.misnamed)))
        ordered = sorted(names.items(), key=lambda item: (-item[1], item[0]))
        reported = ", ".join(f"`{name}` {count}" for name, count in ordered)
        rows.append([_words(kind), str(len(own)), str(driven.good), str(misnamed.good), reported])
    return table(["effect", "campaigns", "reported with its inputs", "given a name", "which"], rows)


def foreign(campaigns: Sequence[Assessed]) -> str:
    """The table of foreign worlds: wrong names, reported inputs, and remaining errors."""
    wrong = [campaign for campaign in campaigns if campaign.misnamed]
    doubted = [campaign for campaign in campaigns if campaign.suspected and not campaign.misnamed]
    drives = [(campaign, effect) for campaign in campaigns for effect in campaign.hidden if effect.follows]
    reported = [one.follows_right(effect) for one, effect in drives]
    apart = [(one, effect) for one, effect in drives if effect.of_drivers and effect.clear_drivers(CLEAR_PART)]
    clear = [one.follows_right(effect, CLEAR_PART) for one, effect in apart]
    idle = [campaign for campaign in campaigns if campaign.idle_columns]
    of_one = [right for right, (_, effect) in zip(reported, drives, strict=True) if len(effect.follows) == 1]
    recorded = [
        campaign for campaign in campaigns if all(effect.kind != "NobodyRecorded" for effect in campaign.hidden)
    ]
    rows = [
        ["a wrong name reported as found", f"{len(wrong)} of {len(campaigns)}", "at most 1 in 20"],
        ["suspected names, none found", f"{len(doubted)} of {len(campaigns)}", ""],
        [
            "effects reported as unexplained, with all their inputs",
            f"{sum(reported)} of {len(reported)}",
            "at least 8 in 10",
        ],
        *(
            [["the same, only inputs with a clear part of their own", f"{sum(clear)} of {len(clear)}", ""]]
            * bool(clear)
        ),
        ["such effects of a single column", f"{sum(of_one)} of {len(of_one)}", ""],
        ["campaigns with an idle column reported", f"{len(idle)} of {len(campaigns)}", ""],
        ["held-out error / noise floor, median", _median_ratio(campaigns), "at most 1.2"],
        ["the same where all inputs are recorded", _median_ratio(recorded), ""],
    ]
    return table(["", "reached", "asked"], rows)


def _median_ratio(campaigns: Sequence[Assessed]) -> str:
    ratios = [campaign.floor_ratio for campaign in campaigns if campaign.floor_ratio]
    return f"{np.median(ratios):.2f}" if ratios else ""


def unforeseen(campaigns: Sequence[Assessed]) -> str:
    """Return the table of unforeseen effects, all together in its last row."""
    driven, misnamed = rates.driven(campaigns), rates.misnamed(campaigns)
    shares = (f"{count.good} of {count.trials}: {_range(count)}" for count in (driven, misnamed))
    return "\n".join([unknown(campaigns), f"| all | {driven.trials} | {' | '.join(shares)} |  |"])


def _range(count: Count) -> str:
    low, high = rates.interval(count.good, count.trials)
    return f"{_percent(low)} to {_percent(high)}"


def _words(kind: str) -> str:
    """Return ``GrowingNoise`` as ``growing noise``."""
    return "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in kind).strip()


def wrong(campaigns: Sequence[Assessed]) -> str:
    """Return every clear campaign with effects of the catalogue that went wrong, so that each can be drawn again."""
    bad = [one for one in _clear(campaigns) if one.hidden and one.hidden[0].cause != NAME and _went_wrong(one)]
    bad += [campaign for campaign in campaigns if not campaign.hidden and campaign.found]
    rows = [[one.name, str(one.record["truth"]["layout"]), _hidden(one), _found(one)] for one in bad]
    return table(["campaign", "layout", "hidden, at signal-to-noise", "found"], rows)


def _went_wrong(assessed: Assessed) -> bool:
    return bool(assessed.missed or assessed.invented or any(assessed.misplaced(effect) for effect in assessed.hidden))


def _hidden(assessed: Assessed) -> str:
    strength = {float("inf"): ""}
    reported = (
        f"{e.kind} {' '.join(sorted(e.subject))} {strength.get(e.strength, f'{e.strength:.1f}')}"
        for e in assessed.hidden
    )
    return "; ".join(" ".join(words.split()) for words in reported) or "nothing"


def _found(assessed: Assessed) -> str:
    reported = (f"{row.cause} {' '.join(sorted(row.subject | row.follows))}".strip() for row in assessed.found)
    return "; ".join(reported) or "nothing"


def confusion(campaigns: Sequence[Assessed], instrument: Instrument) -> tuple[list[str], list[str], NDArray]:
    """Return rows (hidden effects), columns (reported effects) and shares, of clear campaigns with one effect.

    What is called indistinguishable from the right name counts as the right name.
    """
    rows, columns = [*instrument.catalogue, NAME], [*instrument.catalogue, NAME, "nothing"]
    counts = np.zeros((len(rows), len(columns)))
    for one in _clear(campaigns):
        if len(one.hidden) == 1:
            cause = one.hidden[0].cause
            first = one.found[0].cause if one.found else "nothing"
            reported = cause if not one.missed and one.found else first
            counts[rows.index(cause), columns.index(reported)] += 1
    return rows, columns, counts
