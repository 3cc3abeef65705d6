"""The command line `truing`; the commands call functions of other modules."""

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


# Help without rich, because rich would delay it by a third of a second.
app = typer.Typer(
    name="truing",
    help="Find out what the simulation of a mechanism gets wrong, from measured points and readings.",
    epilog="Example: truing run sample_data/telescope",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


class _QaGate(StrEnum):
    """Effect of a failed quality check on the exit code."""

    WARN = "warn"
    FAIL = "fail"


class _Method(StrEnum):
    """Search method of `design`."""

    EXCHANGE = "exchange"
    DIRECT = "direct"
    IOOPS = "ioops"
    RANDOM = "random"


class _Within(StrEnum):
    """Limits on the configurations of `design`."""

    WORKSPACE = "workspace"
    ACTUATORS = "actuators"


Campaigns = Annotated[list[Path], typer.Argument(metavar="CAMPAIGN", help="Folders with a campaign.toml.")]
_OneCampaign = Annotated[Path, typer.Argument(metavar="CAMPAIGN", help="Folder with a campaign.toml.")]
_Out = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder of the run; default: runs/<campaign name>.")
]
_OutTable = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="A .csv or .parquet file; default: CSV on stdout.")
]
_Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers.")]
_Gate = Annotated[
    _QaGate, typer.Option("--qa", help="fail: a failed quality check gives exit code 3; warn: it gives 0.")
]
_Anew = Annotated[
    bool, typer.Option("--check", help="Read every file again, even if its size, time and inode are unchanged.")
]
_Quiet = Annotated[bool, typer.Option("--quiet", help="Print only problems.")]
_Workers = Annotated[
    int | None, typer.Option("--workers", min=1, max=1000, metavar="N", help="Number of parallel processes.")
]
_Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="ADDRESS", help="Dask scheduler, tcp://host:port; local: start one for this call."
    ),
]


def _listed(words: str) -> tuple[str, ...]:
    """Words of a comma-separated option."""
    return tuple(word.strip() for word in words.split(",") if word.strip())


def _pair(option: str, text: str) -> tuple[float, float]:
    """Two numbers separated by a comma; raises typer.BadParameter."""
    try:
        low, high = (float(word) for word in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"{option}: two numbers separated by a comma, such as 500,1500; found {text!r}"
        ) from None
    if not (math.isfinite(low) and math.isfinite(high)):
        raise typer.BadParameter(f"{option}: finite numbers; found {text!r}")
    return low, high


def workforce(workers: int | None, scheduler: str | None) -> Workforce:
    """Workforce by the options; raises typer.BadParameter."""
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
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Find out what the simulation of a mechanism gets wrong, from measured points and readings."""


@app.command()
def run(
    campaigns: Campaigns,
    out: _Out = None,
    first: Annotated[
        str | None, typer.Option("--from", metavar="STAGE", help="Run this stage and all later stages again.")
    ] = None,
    only: Annotated[
        str | None, typer.Option("--only", metavar="STAGE", help="Run only this stage and the stages that it needs.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Run all stages, even if up to date.")] = False,
    qa: _Gate = _QaGate.FAIL,
    check: _Anew = False,
    quiet: _Quiet = False,
    workers: _Workers = None,
    scheduler: _Scheduler = None,
) -> None:
    """Analyse campaigns: run all stages that are not up to date, and write the report.

    Several campaigns run one after the other, each in its own folder; with --workers or --scheduler they run in
    parallel, with the same results. The workers of a Dask cluster need the same files at the same paths. Photographs
    of one campaign are measured on all cores, or in the number of processes given by --workers.

    Exit codes: 0 done; 1 defect of the software; 2 campaign cannot be used; 3 done, but a quality check failed;
    4 problem of the environment; 130 ended by Ctrl-C.

    Example: truing run sample_data/telescope --from pose
    """
    from truing.pipeline.run_campaign import RunOptions, StageSelection, run_campaigns

    if first is not None and only is not None:
        raise typer.BadParameter("--from and --only exclude each other")
    options = RunOptions(StageSelection(first, only, force), distrust=check, accept_failed_checks=qa is _QaGate.WARN)
    raise typer.Exit(run_campaigns(campaigns, out, options, quiet=quiet, workforce=workforce(workers, scheduler)))


@app.command()
def stages(
    campaign: Annotated[
        Path | None, typer.Argument(metavar="CAMPAIGN", help="Folder with a campaign.toml; absent: list all stages.")
    ] = None,
    out: _Out = None,
    check: _Anew = False,
) -> None:
    """Show the state of each stage of a campaign: fresh, stale (with the reason) or never run.

    Without a campaign, list all stages.

    Example: truing stages sample_data/telescope
    """
    from truing.pipeline.run_campaign import show_all_stages, show_status

    _end(show_all_stages if campaign is None else lambda: show_status(campaign, out, distrust=check))


@app.command()
def check(campaigns: Campaigns) -> None:
    """Validate campaigns without running them: report all faults of campaign.toml and of the raw files.

    Writes nothing.

    Example: truing check my-campaign
    """
    from truing.pipeline.campaign_check import report_check

    _end(*(lambda place=place: report_check(place) for place in campaigns))


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder with raw files and without campaign.toml.")],
    every_key: Annotated[bool, typer.Option("--all", help="Write all keys, with explanations.")] = False,
) -> None:
    """Write a campaign.toml for the raw files of a folder, to be completed by hand.

    An existing campaign.toml is never overwritten, and a raw file is never changed.

    Example: truing init my-campaign
    """
    from truing.pipeline.init_campaign import init_campaign

    _end(lambda: init_campaign(folder, every_key=every_key))


@app.command()
def predict(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Folder of a run, or its model.toml or sensor.toml.")],
    inputs: Annotated[
        Path,
        typer.Argument(
            metavar="INPUTS",
            help="Table of configurations, load steps, commands or signals, .csv or .parquet; or the folder of a "
            "second campaign of the same machine.",
        ),
    ],
    out: _OutTable = None,
) -> None:
    """Predict poses or readings with the extended model, or test its predictions on a second campaign.

    A table of configurations gives poses of the platform in the frame of the base, with 6 x 6 covariance. Load steps of
    a force sensor give interferometer readings. Commands of an axis give encoder readings, each with its sigma. Signals
    of a calibrated force sensor give wrenches with covariance. The table needs every column on which an effect of the
    model depends.

    For the folder of a second campaign of the same machine, the result is the rms and largest error of the nominal, the
    calibrated and the extended model. The calibration is read from the folder of the model.

    The result is written as CSV to standard output, or to the file --out (.csv or .parquet).

    Example: truing predict runs/telescope/model.toml configurations.csv --out predicted.parquet
    """

    def tell() -> ExitCode:
        from truing.pipeline.predict_command import predict_file

        return predict_file(model, inputs, out)

    _end(tell)


@app.command()
def design(
    campaign: _OneCampaign,
    poses: Annotated[int, typer.Option("--poses", min=1, max=1000, help="Number of configurations to choose.")] = 40,
    verification: Annotated[
        int, typer.Option("--verification", min=0, max=1000, help="Number of additional verification poses.")
    ] = 0,
    extend: Annotated[
        Path | None, typer.Option("--extend", metavar="FILE", help="Keep the poses of this table and add others.")
    ] = None,
    avoid: Annotated[
        Path | None,
        typer.Option(
            "--avoid", metavar="FILE", help="Table of forbidden regions, one per row: x_min_mm, rho1_max_mm, ..."
        ),
    ] = None,
    method: Annotated[_Method, typer.Option("--method", help="Search method.")] = _Method.EXCHANGE,
    within: Annotated[
        _Within, typer.Option("--within", help="workspace: all limits of [workspace]; actuators: only rho_mm.")
    ] = _Within.WORKSPACE,
    parameters: Annotated[
        str,
        typer.Option(
            "--parameters",
            metavar="NAMES",
            help="Parameters of each leg, such as a_x,b_x,l; default: all identifiable.",
        ),
    ] = "",
    trade_off: Annotated[
        float,
        typer.Option(
            "--trade-off",
            min=0.0,
            max=1.0,
            help="Order of poses: 0 shortest travel, 1 least correlation of time with poses.",
        ),
    ] = 0.75,
    at_once: Annotated[
        int,
        typer.Option("--at-once", min=1, max=6, help="Interferometer: number of load components that act together."),
    ] = 6,
    causes: Annotated[
        str,
        typer.Option(
            "--causes",
            metavar="NAMES",
            help="Interferometer: choose loads that show these causes instead of loads for a calibration.",
        ),
    ] = "",
    accuracy: Annotated[
        bool, typer.Option("--accuracy", help="Instead: accuracy of the pose from that of the actuators.")
    ] = False,
    uniqueness: Annotated[
        bool, typer.Option("--uniqueness", help="Instead: proof that readings determine the pose over the workspace.")
    ] = False,
    tolerances: Annotated[
        bool, typer.Option("--tolerances", help="Instead: errors of a force sensor's platform by each tolerance.")
    ] = False,
    seed: _Seed = 0,
    out: _OutTable = None,
) -> None:
    """Choose configurations that give the most information for a calibration, and report their D-efficiency.

    This needs a campaign.toml with a mechanism and a [workspace]. Poses that are already measured are evaluated in the
    same way. For an interferometer campaign, it chooses load steps within [loading] that give the most information on
    the sensor's calibration matrix. With --causes, it chooses runs of loads that halve the uncertainty of these causes,
    in addition to the steps measured or planned.

    --accuracy, --uniqueness and --tolerances choose nothing. They write tables next to FILE (default:
    runs/<name>/accuracy.csv and so on) and a page, FILE.html.

    Example: truing design sample_data/telescope --poses 40 --verification 6 --out configurations.csv

    Example: truing design sample_data/force-sensor --causes hysteresis,creep --out loads.csv
    """

    def choose() -> ExitCode:
        from truing.pipeline.design_command import DesignFiles, design_campaign
        from truing.pipeline.design_study import study_campaign
        from truing.stages.configurations.chosen import DesignOptions

        names = _listed(parameters)
        shown = _listed(causes)
        options = DesignOptions(poses, verification, method.value, within.value, names, trade_off, seed, at_once, shown)
        wanted = {"accuracy": accuracy, "uniqueness": uniqueness, "tolerances": tolerances}
        studies = [name for name, chosen in wanted.items() if chosen]
        if studies:
            return study_campaign(campaign, studies, options, DesignFiles(extend, avoid, out))
        return design_campaign(campaign, options, DesignFiles(extend, avoid, out))

    _end(choose)


@app.command()
def power(
    campaign: _OneCampaign,
    causes: Annotated[
        str,
        typer.Option(
            "--causes", metavar="NAMES", help="Ids of causes, separated by commas; default: the whole catalogue."
        ),
    ] = "",
    draws: Annotated[
        int, typer.Option("--draws", min=0, max=10000, help="Simulated campaigns per size and effect; 0: theory only.")
    ] = 4,
    gross: Annotated[float, typer.Option("--gross", min=0.0, max=0.2, help="Share of points with gross errors.")] = 0.0,
    seed: _Seed = 0,
    workers: _Workers = None,
    scheduler: _Scheduler = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help=".csv or .parquet file; default: runs/<name>/power.parquet."),
    ] = None,
) -> None:
    """Simulate campaigns of this layout with hidden effects, diagnose them, and report the detectable size of each.

    This needs no measurement: campaign.toml, targets.csv and configurations.csv are enough; for a bench, campaign.toml
    and an interferometer.csv without readings. Causes that rays of photographs show need a run. Writes detectable sizes
    (FILE), detection rates (FILE-rates) and a page (FILE.html). Exit codes as for `truing run`.

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
    stations: Annotated[int, typer.Option("--stations", min=3, max=200, help="Largest number of photographs.")] = 12,
    wanted: Annotated[
        float | None,
        typer.Option(
            "--wanted", metavar="MM", min=1e-6, help="Stop once the standard deviation of every target is below this."
        ),
    ] = None,
    distance: Annotated[
        str,
        typer.Option(
            "--distance", metavar="MM,MM", help="Nearest and farthest distance of sharp focus; default: no limit."
        ),
    ] = "",
    elevation: Annotated[
        str,
        typer.Option(
            "--elevation", metavar="DEG,DEG", help="Lowest and highest elevation of stations above the xy-plane."
        ),
    ] = "0,80",
    incidence: Annotated[
        float, typer.Option("--incidence", min=1.0, max=89.0, help="Largest angle from a target's normal, degrees.")
    ] = 60.0,
    least: Annotated[
        float, typer.Option("--least", min=0.0, max=1000.0, help="Smallest image of a target, pixels.")
    ] = 8.0,
    directions: Annotated[int, typer.Option("--directions", min=8, max=500, help="Number of directions to try.")] = 60,
    camera: Annotated[
        str | None, typer.Option("--camera", metavar="NAME", help="Name of the camera, if the campaign has several.")
    ] = None,
    run: Annotated[
        Path | None,
        typer.Option("--run", metavar="RUN", help="Run folder from which to take the adjusted camera and its noise."),
    ] = None,
    normals: Annotated[
        Path | None,
        typer.Option(
            "--normals", metavar="FILE", help="Table of target normals: body, target, normal_x, normal_y, normal_z."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help=".csv or .parquet file; default: runs/<name>/plan.csv."),
    ] = None,
) -> None:
    """Choose camera stations, and predict the standard deviations of the targets.

    This needs no photograph: targets.csv, a camera and the noise of an image point in campaign.toml are enough. Without
    a camera in campaign.toml, that of the campaign's run or of its photographs is used. Scale bars are used if their
    ends are targets. Writes the stations (FILE), predicted standard deviations (FILE-targets, FILE-bodies), their
    dependence on the number of photographs (FILE-curve) and a page (FILE.html).

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
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, such as runs/telescope.")],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="FORMS",
            help="csv, xlsx, json, controller (default: these four), urdf or dcc, separated by commas.",
        ),
    ] = "",
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Output folder; default: RUN/exports.")
    ] = None,
    campaign: Annotated[
        Path | None, typer.Option("--campaign", metavar="CAMPAIGN", help="For dcc: folder with campaign.toml.")
    ] = None,
) -> None:
    """Write the results of a run in other file formats.

    csv: every table. xlsx: every table as a sheet of one workbook. json: a summary for a database. controller: the
    parameters of the extended model with their sigmas, as TOML and as a plain table. urdf: the identified robot, and
    corrections of its joints; open chains alone. dcc: a digital calibration
    certificate of the results that qualify, with the entries of [certificate] in campaign.toml.

    Example: truing export runs/telescope --to xlsx,controller
    """

    def write() -> ExitCode:
        from truing.pipeline.recorded_runs import export_run

        return export_run(run, _listed(to), out, campaign)

    _end(write)


@app.command()
def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN RUN...", help="Folders of runs, in order of time.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Output folder; default: comparison, next to the first run."),
    ] = None,
) -> None:
    """Compare campaigns of one machine, and report which of its parameters have changed.

    Each run is compared with the previous one. Writes compared.parquet (every parameter of every run, its change, and
    whether the change is significant) and comparison.html.

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
