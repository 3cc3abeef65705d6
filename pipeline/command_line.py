"""The command line `truing`: a thin face of the functions that do the work."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from truing.pipeline.problems import ExitCode

if TYPE_CHECKING:
    from truing.pipeline.executor import Workforce


# Without rich's formatting of help: it would cost a third of a second before the first word.
app = typer.Typer(
    name="truing",
    help="Diagnose where a mechanism and its simulation part ways, from measured points and readings.",
    epilog="Example: truing run sample_data/telescope",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


class _QaGate(StrEnum):
    """What a failed QA check does to the exit code."""

    WARN = "warn"
    FAIL = "fail"


class _Method(StrEnum):
    """How `design` searches."""

    EXCHANGE = "exchange"
    DIRECT = "direct"
    IOOPS = "ioops"
    RANDOM = "random"


class _Within(StrEnum):
    """What limits the configurations that `design` may choose."""

    WORKSPACE = "workspace"
    ACTUATORS = "actuators"


Campaigns = Annotated[list[Path], typer.Argument(metavar="CAMPAIGN", help="Folders that hold a campaign.toml.")]
_OneCampaign = Annotated[Path, typer.Argument(metavar="CAMPAIGN", help="A folder that holds a campaign.toml.")]
_Out = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="The run's folder; default: runs/<campaign name>.")
]
_OutTable = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="A .csv or .parquet file; default: CSV on stdout.")
]
_Seed = Annotated[int, typer.Option("--seed", min=0, help="Of the random draws.")]
_Gate = Annotated[_QaGate, typer.Option("--qa", help="Whether a failed check is exit code 3 or only told.")]
_Anew = Annotated[bool, typer.Option("--check", help="Read every file anew instead of trusting size, time and inode.")]
_Quiet = Annotated[bool, typer.Option("--quiet", help="Say only what went wrong.")]
_Workers = Annotated[
    int | None, typer.Option("--workers", min=1, max=1000, metavar="N", help="Do so many at a time, each in a process.")
]
_Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, tcp://host:port; local: one for this call."),
]


def _listed(words: str) -> tuple[str, ...]:
    """The words of an option that takes several, by commas."""
    return tuple(word.strip() for word in words.split(",") if word.strip())


def _pair(option: str, text: str) -> tuple[float, float]:
    """Two numbers by a comma; raises typer.BadParameter."""
    try:
        low, high = (float(word) for word in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{option}: two numbers by a comma, as 500,1500; found {text!r}") from None
    if not (math.isfinite(low) and math.isfinite(high)):
        raise typer.BadParameter(f"{option}: finite numbers; found {text!r}")
    return low, high


def workforce(workers: int | None, scheduler: str | None) -> Workforce:
    """Who does the work, from the options; raises typer.BadParameter."""
    from truing.pipeline.executor import LOCAL, Workforce

    if scheduler not in (None, LOCAL) and not re.fullmatch(r"(tcp|tls)://[^/\s]+:\d+", scheduler or ""):
        raise typer.BadParameter(
            f"--scheduler: found {scheduler!r}; expected tcp://host:port, tls://host:port or local"
        )
    return Workforce(workers, scheduler)


def _print_version(wanted: bool) -> None:
    if wanted:
        from truing import __version__

        typer.echo(f"truing {__version__}")
        raise typer.Exit


@app.callback()
def truing(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Tell the version and end.")
    ] = False,
) -> None:
    """Diagnose where a mechanism and its simulation part ways, from measured points and readings."""


@app.command()
def run(
    campaigns: Campaigns,
    out: _Out = None,
    first: Annotated[
        str | None, typer.Option("--from", metavar="STAGE", help="Run this stage and all after it again.")
    ] = None,
    only: Annotated[
        str | None, typer.Option("--only", metavar="STAGE", help="Just this stage, and what it needs.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Run stages that are up to date, too.")] = False,
    qa: _Gate = _QaGate.FAIL,
    check: _Anew = False,
    quiet: _Quiet = False,
    workers: _Workers = None,
    scheduler: _Scheduler = None,
) -> None:
    """Run every stage that is not up to date, then say where the report lies.

    Several campaigns are run one after the other, each in its own folder; with --workers or --scheduler several at a
    time, with the same results. The workers of a Dask cluster must see the same files at the same places. Photographs
    of one campaign are measured on all cores, or in as many processes as --workers says.

    Exit codes: 0 done; 1 a defect of the software; 2 the campaign cannot be used; 3 done, but a QA check failed;
    4 the environment prevented it; 130 Ctrl-C ended it.

    Example: truing run sample_data/telescope --from pose
    """
    from truing.pipeline.run_campaign import RunOptions, StageSelection, run_campaigns

    if first is not None and only is not None:
        raise typer.BadParameter("--from and --only exclude each other")
    options = RunOptions(StageSelection(first, only, force), distrust=check, accept_failed_checks=qa is _QaGate.WARN)
    raise typer.Exit(run_campaigns(campaigns, out, options, quiet=quiet, workforce=workforce(workers, scheduler)))


@app.command()
def stages(
    campaign: Annotated[Path | None, typer.Argument(metavar="CAMPAIGN", help="Absent: the stages there are.")] = None,
    out: _Out = None,
    check: _Anew = False,
) -> None:
    """Show each stage of a campaign as fresh, stale (and why) or never run; without one, list the stages there are.

    Example: truing stages sample_data/telescope
    """
    from truing.pipeline.run_campaign import show_all_stages, show_status

    _end(show_all_stages if campaign is None else lambda: show_status(campaign, out, distrust=check))


@app.command()
def check(campaigns: Campaigns) -> None:
    """Validate campaigns without running them: every fault of campaign.toml and of the raw files; nothing is written.

    Example: truing check my-campaign
    """
    from truing.pipeline.campaign_check import report_check

    _end(*(lambda place=place: report_check(place) for place in campaigns))


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A folder with raw files and no campaign.toml yet.")],
    every_key: Annotated[bool, typer.Option("--all", help="Write every key there is, explained.")] = False,
) -> None:
    """Look at the raw files of a folder and write a campaign.toml to complete, with what this campaign needs.

    An existing campaign.toml is never overwritten, and a raw file is never changed.

    Example: truing init my-campaign
    """
    from truing.pipeline.init_campaign import init_campaign

    _end(lambda: init_campaign(folder, every_key=every_key))


@app.command()
def predict(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="The folder of a run, or the model.toml or sensor.toml in it.")
    ],
    inputs: Annotated[
        Path,
        typer.Argument(
            metavar="INPUTS",
            help="A table of configurations, load steps, commands or signals, .csv or .parquet; or the folder of a "
            "second campaign of the same machine.",
        ),
    ],
    out: _OutTable = None,
) -> None:
    """Predict poses or readings with the extended model, or test its predictions on a second campaign.

    INPUTS is a table: configurations of a mechanism give poses of the platform seen from the base, with their 6 x 6
    covariance; load steps of a force sensor give interferometer readings; commands of an axis give the readings of
    its encoders, each with its sigma; signals of a calibrated force sensor give wrenches with their covariance. The
    table needs every column that an effect of the model depends on.

    Where INPUTS is the folder of a second campaign of the same machine, its measurements are compared with predictions
    by the nominal, the calibrated and the extended model: rms and largest error of each. The calibration is that of the
    run in the folder of the model.

    The result is CSV on standard output, or the file --out, as .csv or .parquet.

    Example: truing predict runs/telescope/model.toml configurations.csv --out predicted.parquet
    """

    def tell() -> ExitCode:
        from truing.pipeline.predict_command import predict_file

        return predict_file(model, inputs, out)

    _end(tell)


@app.command()
def design(
    campaign: _OneCampaign,
    poses: Annotated[int, typer.Option("--poses", min=1, max=1000, help="How many configurations to choose.")] = 40,
    verification: Annotated[
        int, typer.Option("--verification", min=0, max=1000, help="How many more to hold out, among the chosen.")
    ] = 0,
    extend: Annotated[
        Path | None, typer.Option("--extend", metavar="FILE", help="Keep the poses of this table, and add to them.")
    ] = None,
    avoid: Annotated[
        Path | None,
        typer.Option("--avoid", metavar="FILE", help="Forbidden regions, a row each: x_min_mm, rho1_max_mm, ..."),
    ] = None,
    method: Annotated[_Method, typer.Option("--method", help="How to search.")] = _Method.EXCHANGE,
    within: Annotated[
        _Within, typer.Option("--within", help="All limits of [workspace], or rho_mm alone.")
    ] = _Within.WORKSPACE,
    parameters: Annotated[
        str,
        typer.Option("--parameters", metavar="NAMES", help="Of each leg: a_x,b_x,l; default: all that can be known."),
    ] = "",
    trade_off: Annotated[
        float, typer.Option("--trade-off", min=0.0, max=1.0, help="Order: 0 short travel, 1 time apart from poses.")
    ] = 0.75,
    at_once: Annotated[
        int, typer.Option("--at-once", min=1, max=6, help="Interferometer: components of a load that act together.")
    ] = 6,
    causes: Annotated[
        str,
        typer.Option(
            "--causes", metavar="NAMES", help="Interferometer: loads that show these, not those to calibrate by."
        ),
    ] = "",
    seed: _Seed = 0,
    out: _OutTable = None,
) -> None:
    """Choose where to measure: the configurations from which a calibration learns most, and how near the best they are.

    A campaign.toml with a mechanism and a [workspace] is enough; poses measured already are judged by the same measure.
    Of an interferometer campaign: load steps within [loading] that tell most of the sensor's calibration matrix; with
    --causes, runs of loads after which these causes are known twice as well, beside the steps measured or planned.

    Example: truing design sample_data/telescope --poses 40 --verification 6 --out configurations.csv

    Example: truing design sample_data/force-sensor --causes hysteresis,creep --out loads.csv
    """

    def choose() -> ExitCode:
        from truing.pipeline.design_command import DesignFiles, design_campaign
        from truing.stages.configurations.chosen import DesignOptions

        names = _listed(parameters)
        shown = _listed(causes)
        options = DesignOptions(poses, verification, method.value, within.value, names, trade_off, seed, at_once, shown)
        return design_campaign(campaign, options, DesignFiles(extend, avoid, out))

    _end(choose)


@app.command()
def power(
    campaign: _OneCampaign,
    causes: Annotated[
        str, typer.Option("--causes", metavar="NAMES", help="Ids of causes, by commas; default: all of the catalogue.")
    ] = "",
    draws: Annotated[
        int, typer.Option("--draws", min=0, max=10000, help="Campaigns to draw per size and effect; 0: theory alone.")
    ] = 4,
    gross: Annotated[
        float, typer.Option("--gross", min=0.0, max=0.2, help="Share of points that are grossly wrong.")
    ] = 0.0,
    seed: _Seed = 0,
    workers: _Workers = None,
    scheduler: _Scheduler = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="A .csv or .parquet file; default: runs/<name>/power.parquet."),
    ] = None,
) -> None:
    """Hide effects in a campaign of this one's layout, diagnose it, and tell from which size on they are found.

    Needs no measurement yet: campaign.toml, targets.csv and configurations.csv are enough; of a bench, campaign.toml
    and an interferometer.csv without readings. Causes that rays of photographs show need a run. Leaves the sizes, the
    rates (FILE-rates) and a page (FILE.html). Exit codes as of `truing run`.

    Example: truing power sample_data/telescope --causes actuator-gain,leg-drift --draws 8 --workers 4
    """

    def tell() -> ExitCode:
        from truing.pipeline.power_command import PowerOptions, power_campaign

        names = _listed(causes)
        return power_campaign(campaign, PowerOptions(names, draws, gross, seed), workforce(workers, scheduler), out)

    _end(tell)


@app.command()
def plan(
    campaign: _OneCampaign,
    stations: Annotated[int, typer.Option("--stations", min=3, max=200, help="Photographs to take at most.")] = 12,
    wanted: Annotated[
        float | None,
        typer.Option("--wanted", metavar="MM", min=1e-6, help="Stop where every target's standard deviation is below."),
    ] = None,
    distance: Annotated[
        str,
        typer.Option("--distance", metavar="MM,MM", help="Between which a target is sharp; default: wherever it fits."),
    ] = "",
    elevation: Annotated[
        str, typer.Option("--elevation", metavar="DEG,DEG", help="Of stations above the xy-plane, lowest and highest.")
    ] = "0,80",
    incidence: Annotated[
        float, typer.Option("--incidence", min=1.0, max=89.0, help="Largest angle from a target's normal, degrees.")
    ] = 60.0,
    least: Annotated[
        float, typer.Option("--least", min=0.0, max=1000.0, help="Smallest image of a target, pixels.")
    ] = 8.0,
    directions: Annotated[int, typer.Option("--directions", min=8, max=500, help="From how many sides to try.")] = 60,
    camera: Annotated[
        str | None, typer.Option("--camera", metavar="NAME", help="Which, where the campaign has several.")
    ] = None,
    run: Annotated[
        Path | None,
        typer.Option("--run", metavar="RUN", help="Take the camera as this run adjusted it, and its noise."),
    ] = None,
    normals: Annotated[
        Path | None,
        typer.Option(
            "--normals", metavar="FILE", help="Where targets face: body, target, normal_x, normal_y, normal_z."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="A .csv or .parquet file; default: runs/<name>/plan.csv."),
    ] = None,
) -> None:
    """Choose where to stand with a camera, and tell how well the targets will be known from there.

    Needs no photograph yet: targets.csv, a camera and the noise of an image point in campaign.toml are enough; without
    a camera there, that of the campaign's own run counts, or of its photographs. Scale bars count where targets are
    their ends. Leaves the stations, predicted standard deviations (FILE-targets,
    FILE-bodies), what fewer or more photographs would do (FILE-curve) and a page (FILE.html).

    Example: truing plan my-campaign --wanted 0.01 --distance 500,1500 --out stations.csv
    """

    def choose() -> ExitCode:
        from truing.estimation.bundle.photograph_plan import PlanOptions
        from truing.pipeline.plan_command import PlanFiles, plan_campaign

        near, far = _pair("--distance", distance) if distance else (None, None)
        bounds = _pair("--elevation", elevation)
        options = PlanOptions(stations, wanted, near, far, bounds, directions, incidence, least)
        return plan_campaign(campaign, options, PlanFiles(camera, run, normals, out))

    _end(choose)


@app.command()
def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a run, as runs/telescope.")],
    to: Annotated[
        str,
        typer.Option("--to", metavar="FORMS", help="Of csv, xlsx, json, controller (default: these), dcc; by commas."),
    ] = "",
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Where to; default: RUN/exports.")] = None,
    campaign: Annotated[
        Path | None, typer.Option("--campaign", metavar="CAMPAIGN", help="For dcc: the folder with campaign.toml.")
    ] = None,
) -> None:
    """Write a run's results in the forms that others read.

    csv: every table. xlsx: every table as a sheet of one workbook. json: a summary for a database. controller: the
    extended model's numbers with their sigmas, as TOML and as a plain table. dcc: a digital calibration certificate
    of the results that qualify, with what [certificate] of campaign.toml tells.

    Example: truing export runs/telescope --to xlsx,controller
    """

    def write() -> ExitCode:
        from truing.pipeline.recorded_runs import export_run

        return export_run(run, _listed(to), out, campaign)

    _end(write)


@app.command()
def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN RUN...", help="Folders of runs, in their order.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where to; default: comparison, beside the first run.")
    ] = None,
) -> None:
    """Put campaigns of one machine side by side, and tell which of its numbers have changed.

    Each run is compared with the one before. Leaves compared.parquet (every number of every run, its change, and
    whether that is beyond chance) and comparison.html.

    Example: truing compare runs/2026-spring runs/2026-autumn --out runs/comparison
    """

    def compare_them() -> ExitCode:
        from truing.pipeline.recorded_runs import compare_runs

        return compare_runs(runs, out)

    _end(compare_them)


def _end(*actions: Callable[[], ExitCode]) -> None:
    from truing.pipeline.console import RunConsole
    from truing.pipeline.exit_status import end_all

    raise typer.Exit(end_all(list(actions), RunConsole(quiet=False)))
