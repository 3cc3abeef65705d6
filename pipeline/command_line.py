"""The command line `truing`; the commands call functions of other modules."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from truing.pipeline import command_options as option
from truing.pipeline.option_values import number_pair, workforce
from truing.pipeline.problems import ExitCode

if TYPE_CHECKING:
    from truing.pipeline.console import RunConsole

COMPLETE = "_TRUING_COMPLETE"  # set by the shell that asks for completions
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


def _listed(words: str) -> tuple[str, ...]:
    """Words of a comma-separated option."""
    return tuple(word.strip() for word in words.split(",") if word.strip())


def _print_version(wanted: bool) -> None:
    if wanted:
        from truing import __version__

        typer.echo(f"truing {__version__}")
        raise typer.Exit


def _print_completion(shell: option.Shell | None) -> None:
    if shell is not None:
        from typer.completion import get_completion_script

        names = {
            "prog_name": "truing",
            "complete_var": COMPLETE,
            "shell": shell.value,
        }  # a text is made, nothing is run
        typer.echo(get_completion_script(**names))
        raise typer.Exit


@app.callback()
def truing(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    completion: Annotated[
        option.Shell | None,
        typer.Option(
            "--completion",
            callback=_print_completion,
            is_eager=True,
            metavar="SHELL",
            help="Print the completion for bash, zsh or fish, and exit.",
        ),
    ] = None,
) -> None:
    """Find out what the simulation of a mechanism gets wrong, from measured points and readings."""


@app.command(short_help="Run all stages that are not up to date; write the report.")
def run(
    campaigns: option.Campaigns,
    out: option.RunFolder = None,
    first: option.RunFirst = None,
    only: option.RunOnly = None,
    force: option.RunForce = False,
    qa: option.Gate = option.QaGate.FAIL,
    check: option.ReadAnew = False,
    quiet: option.Quiet = False,
    verbose: option.Verbose = False,
    json: option.Json = False,
    workers: option.Workers = None,
    scheduler: option.Scheduler = None,
) -> None:
    """Analyse campaigns: run all stages that are not up to date, and write the report.

    Several campaigns run one after the other, or in parallel with --workers or --scheduler. The workers of a Dask
    cluster need the same files at the same paths. Photographs of one campaign are measured on all cores, or by as many
    processes as --workers says.

    Several campaigns also leave runs/campaigns.html and runs/campaigns.parquet: the verdicts of all, the worst first.
    A campaign that cannot be used does not stop the others.

    Exit codes: 0 done; 1 defect of the software; 2 campaign cannot be used; 3 done, but a quality check failed;
    4 problem of the environment; 130 ended by Ctrl-C.

    Example: truing run sample_data/telescope --from pose

    Example: truing run sample_data/telescope sample_data/robot --workers 2
    """
    from truing.pipeline.run_campaign import RunOptions, StageSelection, run_campaigns

    if first is not None and only is not None:
        raise typer.BadParameter("--from and --only exclude each other")
    options = RunOptions(
        StageSelection(first, only, force),
        distrust=check,
        accept_failed_checks=qa is option.QaGate.WARN,
        verbose=verbose,
    )
    console = _console(quiet=quiet, json=json, verbose=verbose)
    raise typer.Exit(run_campaigns(campaigns, out, options, console, workforce=workforce(workers, scheduler)))


@app.command(short_help="Run a campaign again whenever its files change.")
def watch(
    campaign: option.OneCampaign,
    out: option.RunFolder = None,
    once: option.WatchOnce = False,
    interval: option.WatchInterval = 2.0,
    port: option.WatchPort = None,
    page: option.WatchPage = True,
    quiet: option.Quiet = False,
    verbose: option.WatchVerbose = False,
    json: option.WatchJson = False,
) -> None:
    """Run a campaign again whenever its files change, while it is measured, and report whether the measurements are
    enough.

    Each round prints one line: whether the requirements are decided, and the next measurement. A page on this machine
    alone also shows quality checks and all verdicts. The command waits for files that are being written, and goes on
    after faults. It ends when the requirements are decided, or with Ctrl-C.

    Example: truing watch sample_data/telescope --once
    """
    console = _console(quiet=quiet, verbose=verbose)

    def act() -> ExitCode:
        from truing.pipeline.watch_command import WatchOptions, watch_campaign

        return watch_campaign(campaign, out, WatchOptions(interval, once, json, port, page), console)

    _end(act, console=console, says_reason=not json)


@app.command(short_help="Show whether each stage is fresh, stale or never run.")
def stages(
    campaign: option.StagesCampaign = None,
    out: option.RunFolder = None,
    check: option.ReadAnew = False,
    quiet: option.Quiet = False,
    json: option.Json = False,
) -> None:
    """Show the state of each stage of a campaign: fresh, stale (with the reason) or never run.

    Without a campaign, list all stages.

    Example: truing stages sample_data/telescope
    """
    from truing.pipeline.run_campaign import show_all_stages, show_status

    console = _console(quiet=quiet, json=json)
    if campaign is None:
        _end(lambda: show_all_stages(console), console=console)
    else:
        _end(lambda: show_status(campaign, out, console, distrust=check), console=console)


@app.command(short_help="Report all faults of campaigns without running them.")
def check(campaigns: option.Campaigns, quiet: option.Quiet = False, json: option.Json = False) -> None:
    """Validate campaigns without running them: report all faults of campaign.toml and of the raw files.

    Writes nothing.

    Example: truing check sample_data/telescope
    """
    from truing.pipeline.campaign_check import report_check

    console = _console(quiet=quiet, json=json)
    _end(*(lambda path=path: report_check(path, console) for path in campaigns), console=console)


@app.command(short_help="Write a campaign.toml for the raw files of a folder.")
def init(
    folder: option.InitFolder,
    every_key: option.InitEveryKey = False,
    answer: option.InitAnswer = None,
    ask: option.InitAsk = True,
    quiet: option.Quiet = False,
    json: option.Json = False,
) -> None:
    """Write a campaign.toml for the raw files of a folder, to be completed by hand.

    Shows the first rows of each file as they are read. On a terminal, it asks what a file leaves open: unit, decimal
    mark, body. Without an answer, it takes the most probable reading and marks it. It never overwrites a campaign.toml
    and never changes a raw file.

    Example: truing init my-campaign --answer unit=m
    """
    from truing.pipeline.init_campaign import init_campaign
    from truing.pipeline.init_questions import asking

    asked, console = asking() if ask and not (json or quiet) else None, _console(quiet=quiet, json=json)
    _end(lambda: init_campaign(folder, console, every_key=every_key, answers=answer or (), ask=asked), console=console)


@app.command(short_help="Predict poses or readings with the extended model.")
def predict(
    model: option.PredictModel,
    inputs: option.PredictInputs,
    out: option.OutTable = None,
    quiet: option.Quiet = False,
    json: option.Json = False,
) -> None:
    """Predict poses or readings with the extended model, or test its predictions on a second campaign.

    Configurations give poses of the platform in the frame of the base, with 6 x 6 covariance. Load steps of a force
    sensor give interferometer readings, commands of an axis encoder readings, each with its sigma. Signals of a
    calibrated force sensor give wrenches with covariance. The table needs every column on which an effect depends.

    The folder of a second campaign of the same machine gives the rms and largest error of the nominal, the calibrated
    and the extended model. The calibration is read from the folder of the model.

    Writes CSV or, with --json, JSON to standard output, or the file --out (.csv or .parquet).

    Example: truing predict runs/telescope sample_data/telescope/configurations.csv --out predicted.csv
    """

    console = _console(quiet=quiet, json=json)

    def act() -> ExitCode:
        from truing.pipeline.predict_command import predict_file

        return predict_file(model, inputs, out, console)

    _end(act, console=console)


@app.command(short_help="Choose configurations that give the most information.")
def design(
    campaign: option.OneCampaign,
    poses: option.DesignPoses = 40,
    verification: option.DesignVerification = 0,
    extend: option.DesignExtend = None,
    avoid: option.DesignAvoid = None,
    method: option.DesignMethod = option.SearchMethod.EXCHANGE,
    within: option.DesignWithin = option.SearchLimits.WORKSPACE,
    parameters: option.DesignParameters = "",
    trade_off: option.DesignTradeOff = 0.75,
    at_once: option.DesignAtOnce = 6,
    cycles: option.DesignCycles = None,
    causes: option.DesignCauses = "",
    accuracy: option.DesignAccuracy = False,
    uniqueness: option.DesignUniqueness = False,
    tolerances: option.DesignTolerances = False,
    seed: option.Seed = 0,
    out: option.OutTable = None,
    quiet: option.Quiet = False,
    json: option.Json = False,
) -> None:
    """Choose configurations that give the most information for a calibration, and report their D-efficiency.

    A mechanism needs a [workspace]; measured poses are evaluated in the same way. For a force sensor, the command
    chooses load steps within [loading] for the calibration matrix. With --causes, it chooses further runs that halve
    the uncertainty of these causes. For an open chain, it chooses poses within the limits of the joints. It reports
    what they and the measured poses show of geometry, zeros and causes. For a single axis, it chooses targets within
    the travel that show scale error, lost motion and periodic errors.

    --accuracy, --uniqueness and --tolerances choose nothing. They write tables next to FILE (default:
    runs/<name>/accuracy.csv and so on) and a page, FILE.html.

    Example: truing design sample_data/telescope --poses 40 --verification 6 --out configurations.csv

    Example: truing design sample_data/force-sensor --causes hysteresis,creep --out loads.csv

    Example: truing design my-axis --poses 60 --cycles 5 --out configurations.csv
    """

    console = _console(quiet=quiet, json=json)

    def act() -> ExitCode:
        from truing.pipeline.design_command import DesignFiles, design_campaign
        from truing.pipeline.design_study import study_campaign
        from truing.stages.configurations.chosen import DesignOptions

        names = _listed(parameters)
        shown = _listed(causes)
        options = DesignOptions(
            poses, verification, method.value, within.value, names, trade_off, seed, at_once, shown, cycles
        )
        wanted = {"accuracy": accuracy, "uniqueness": uniqueness, "tolerances": tolerances}
        studies = [name for name, chosen in wanted.items() if chosen]
        if studies:
            return study_campaign(campaign, studies, options, DesignFiles(extend, avoid, out), console)
        return design_campaign(campaign, options, DesignFiles(extend, avoid, out), console)

    _end(act, console=console)


@app.command(short_help="Report the size of each effect that would be found.")
def power(
    campaign: option.OneCampaign,
    causes: option.PowerCauses = "",
    draws: option.PowerDraws = 4,
    gross: option.PowerGross = 0.0,
    seed: option.Seed = 0,
    workers: option.Workers = None,
    scheduler: option.Scheduler = None,
    out: option.PowerOut = None,
    quiet: option.Quiet = False,
    json: option.Json = False,
) -> None:
    """Simulate campaigns of this layout with hidden effects, diagnose them, and report the detectable size of each.

    Needs no measurement, but campaign.toml, targets.csv and configurations.csv; for a bench, campaign.toml and an
    interferometer.csv without readings; for a single axis, campaign.toml and a configurations.csv with commands. Causes
    that rays of photographs show need a run. Writes detectable sizes (FILE), detection rates (FILE-rates) and a page
    (FILE.html). Exit codes as for `truing run`.

    Example: truing power sample_data/telescope --causes actuator-gain,leg-drift --draws 8 --workers 4
    """

    console = _console(quiet=quiet, json=json)

    def act() -> ExitCode:
        from truing.pipeline.power_command import PowerOptions, power_campaign

        names = _listed(causes)
        options = PowerOptions(names, draws, gross, seed)
        return power_campaign(campaign, options, workforce(workers, scheduler), out, console)

    _end(act, console=console)


@app.command(short_help="Choose camera stations; predict deviations of targets.")
def plan(
    campaign: option.OneCampaign,
    stations: option.PlanStations = 12,
    wanted: option.PlanWanted = None,
    distance: option.PlanDistance = "",
    elevation: option.PlanElevation = "0,80",
    incidence: option.PlanIncidence = 60.0,
    least: option.PlanLeast = 8.0,
    directions: option.PlanDirections = 60,
    camera: option.PlanCamera = None,
    run: option.PlanRun = None,
    normals: option.PlanNormals = None,
    out: option.PlanOut = None,
    quiet: option.Quiet = False,
    json: option.Json = False,
) -> None:
    """Choose camera stations, and predict the standard deviations of the targets.

    Needs no photograph, but targets.csv and, in campaign.toml, a camera and the noise of an image point. The default
    camera is that of the campaign's run or photographs. Scale bars count if their ends are targets. Writes the stations
    (FILE), predicted standard deviations (FILE-targets, FILE-bodies), their dependence on the number of photographs
    (FILE-curve) and a page (FILE.html).

    Example: truing plan sample_data/telescope-images --wanted 0.01 --out stations.csv
    """

    console = _console(quiet=quiet, json=json)

    def act() -> ExitCode:
        from truing.estimation.bundle.photograph_plan import PlanOptions
        from truing.pipeline.plan_command import PlanFiles, plan_campaign

        near, far = number_pair("--distance", distance) if distance else (None, None)
        bounds = number_pair("--elevation", elevation)
        options = PlanOptions(stations, wanted, near, far, bounds, directions, incidence, least)
        return plan_campaign(campaign, options, PlanFiles(camera, run, normals, out), console)

    _end(act, console=console)


@app.command(short_help="Write the results of a run in other file formats.")
def export(
    run: option.ExportRun,
    to: option.ExportTo = "",
    out: option.ExportOut = None,
    campaign: option.ExportCampaign = None,
    quiet: option.Quiet = False,
    json: option.Json = False,
) -> None:
    """Write the results of a run in other file formats.

    csv: every table. xlsx: every table as a sheet of one workbook. json: a summary for a database. controller: the
    parameters of the extended model with their sigmas, as TOML and as a plain table; of an axis also corrections of its
    commands. urdf: the identified robot, and corrections of its joints; open chains alone. dcc: a digital calibration
    certificate of the results that qualify, with the entries of [certificate] in campaign.toml.

    Example: truing export runs/telescope --to xlsx,controller
    """

    console = _console(quiet=quiet, json=json)

    def act() -> ExitCode:
        from truing.pipeline.recorded_runs import export_run

        return export_run(run, _listed(to), out, console, campaign)

    _end(act, console=console)


@app.command(short_help="Show the verdict and the page of a run; print a PDF.")
def report(
    run: option.ExportRun,
    pdf: option.ReportPdf = False,
    appendix: option.ReportAll = False,
    out: option.ReportOut = None,
    quiet: option.Quiet = False,
    json: option.Json = False,
) -> None:
    """Show the verdict of a run and where its page is; with --pdf, print the page through Chromium or Chrome.

    The browser on PATH is chromium, chromium-browser, google-chrome, google-chrome-stable or chrome. Without one, the
    exit code is 4. The PDF has page numbers, the date and the list of contents.

    Example: truing report runs/telescope --pdf
    """
    console = _console(quiet=quiet, json=json)

    def act() -> ExitCode:
        from truing.pipeline.page_pdf import report_run

        return report_run(run, as_pdf=pdf, everything=appendix, out=out, console=console)

    _end(act, console=console)


@app.command(short_help="Report which parameters of one machine have changed.")
def compare(
    runs: option.CompareRuns,
    out: option.CompareOut = None,
    quiet: option.Quiet = False,
    json: option.Json = False,
) -> None:
    """Compare campaigns of one machine, and report which of its parameters have changed.

    Each run is compared with the previous one. Writes compared.parquet (every parameter of every run, its change, and
    whether the change is significant) and comparison.html.

    Example: truing compare runs/2026-spring runs/2026-autumn --out runs/comparison
    """

    console = _console(quiet=quiet, json=json)

    def act() -> ExitCode:
        from truing.pipeline.recorded_runs import compare_runs

        return compare_runs(runs, out, console)

    _end(act, console=console)


def _console(*, quiet: bool = False, json: bool = False, verbose: bool = False) -> RunConsole:
    """Output by the options."""
    from truing.pipeline.console import JsonConsole, RunConsole

    return JsonConsole() if json else RunConsole(quiet=quiet, verbose=verbose)


def _end(*actions: Callable[[], ExitCode], console: RunConsole | None = None, says_reason: bool = True) -> None:
    """End the call with an exit code; the last line gives the reason of another code than 0."""
    from truing.pipeline.exit_status import end_all

    shown = console or _console()
    code = end_all(list(actions), shown)
    if code and says_reason:
        shown.line(f"exit code {code:d}: {code.meaning}")
    shown.close(code)
    raise typer.Exit(code)
