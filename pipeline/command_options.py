"""Arguments and options of the command line, one type each."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from truing.pipeline import completions


class QaGate(StrEnum):
    """Effect of a failed quality check on the exit code."""

    WARN = "warn"
    FAIL = "fail"


class Shell(StrEnum):
    """Shells whose completion is offered."""

    BASH = "bash"
    ZSH = "zsh"
    FISH = "fish"


class SearchMethod(StrEnum):
    """Search method of `design`."""

    EXCHANGE = "exchange"
    DIRECT = "direct"
    IOOPS = "ioops"
    RANDOM = "random"


class SearchLimits(StrEnum):
    """Limits on the configurations of `design`."""

    WORKSPACE = "workspace"
    ACTUATORS = "actuators"


Campaigns = Annotated[
    list[Path],
    typer.Argument(metavar="CAMPAIGN", autocompletion=completions.campaigns, help="Folders with a campaign.toml."),
]
OneCampaign = Annotated[
    Path, typer.Argument(metavar="CAMPAIGN", autocompletion=completions.campaigns, help="Folder with a campaign.toml.")
]
RunFolder = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder of the run; default: runs/<campaign name>.")
]
OutTable = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="A .csv or .parquet file; default: CSV on stdout.")
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers.")]
Gate = Annotated[QaGate, typer.Option("--qa", help="fail: a failed quality check gives exit code 3; warn: it gives 0.")]
ReadAnew = Annotated[
    bool, typer.Option("--check", help="Read every file again, even if its size, time and inode are unchanged.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only problems.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print also the state of each stage before it runs.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout instead of lines.")]
Workers = Annotated[
    int | None, typer.Option("--workers", min=1, max=1000, metavar="N", help="Number of parallel processes.")
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="ADDRESS", help="Dask scheduler, tcp://host:port; local: start one for this call."
    ),
]

# `truing run`.
RunFirst = Annotated[
    str | None,
    typer.Option(
        "--from",
        metavar="STAGE",
        autocompletion=completions.stages,
        help="Run this stage and all later stages again.",
    ),
]
RunOnly = Annotated[
    str | None,
    typer.Option(
        "--only",
        metavar="STAGE",
        autocompletion=completions.stages,
        help="Run only this stage and the stages that it needs.",
    ),
]
RunForce = Annotated[bool, typer.Option("--force", help="Run all stages, even if up to date.")]

# `truing watch`.
WatchOnce = Annotated[bool, typer.Option("--once", help="End after one round.")]
WatchInterval = Annotated[
    float, typer.Option("--interval", min=0.1, max=3600.0, help="Seconds between two looks at the files.")
]
WatchPort = Annotated[
    int | None,
    typer.Option("--port", min=1, max=65535, help="Port of the page; default: 8765, or any free one."),
]
WatchPage = Annotated[bool, typer.Option("--page/--no-page", help="Serve the page.")]
WatchVerbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print also what each stage of a round did.")]
WatchJson = Annotated[bool, typer.Option("--json", help="Print one JSON object per round, on one line.")]

# `truing stages`.
StagesCampaign = Annotated[
    Path | None,
    typer.Argument(
        metavar="CAMPAIGN",
        autocompletion=completions.campaigns,
        help="Folder with a campaign.toml; absent: list all stages.",
    ),
]

# `truing init`.
InitFolder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder with raw files and without campaign.toml.")]
InitEveryKey = Annotated[bool, typer.Option("--all", help="Write all keys, with explanations.")]

InitAnswer = Annotated[
    list[str] | None,
    typer.Option(
        "--answer",
        metavar="[FILE:]KEY=VALUE",
        autocompletion=completions.answers,
        help="What the files leave open, such as unit=m, or of one file: points*.csv:body=platform; may be repeated.",
    ),
]
InitAsk = Annotated[bool, typer.Option("--ask/--no-ask", help="Ask on a terminal what the files leave open.")]

# `truing predict`.
PredictModel = Annotated[
    Path,
    typer.Argument(
        metavar="MODEL", autocompletion=completions.runs, help="Folder of a run, or its model.toml or sensor.toml."
    ),
]
PredictInputs = Annotated[
    Path,
    typer.Argument(
        metavar="INPUTS",
        help="Table of configurations, load steps, commands or signals, .csv or .parquet; or the folder of a "
        "second campaign of the same machine.",
    ),
]

# `truing design`.
DesignPoses = Annotated[int, typer.Option("--poses", min=1, max=1000, help="Number of configurations to choose.")]
DesignVerification = Annotated[
    int, typer.Option("--verification", min=0, max=1000, help="Number of additional verification poses.")
]
DesignExtend = Annotated[
    Path | None, typer.Option("--extend", metavar="FILE", help="Keep the poses of this table and add others.")
]
DesignAvoid = Annotated[
    Path | None,
    typer.Option(
        "--avoid",
        metavar="FILE",
        help="Table of forbidden regions, one per row: x_min_mm, rho1_max_mm, ...; for a chain also MODULE:FUNCTION of "
        "an installed module.",
    ),
]
DesignMethod = Annotated[SearchMethod, typer.Option("--method", help="Search method.")]
DesignWithin = Annotated[
    SearchLimits, typer.Option("--within", help="workspace: all limits of [workspace]; actuators: only rho_mm.")
]
DesignParameters = Annotated[
    str,
    typer.Option(
        "--parameters",
        metavar="NAMES",
        help="Parameters of each leg, such as a_x,b_x,l; default: all identifiable.",
    ),
]
DesignTradeOff = Annotated[
    float,
    typer.Option(
        "--trade-off",
        min=0.0,
        max=1.0,
        help="Order of poses: 0 shortest travel, 1 least correlation of time with poses.",
    ),
]
DesignAtOnce = Annotated[
    int,
    typer.Option("--at-once", min=1, max=6, help="Interferometer: number of load components that act together."),
]
DesignCycles = Annotated[
    int | None,
    typer.Option(
        "--cycles",
        min=1,
        max=100,
        help="Axis: number of visits of every target from both sides; default: 5, or fewer for at least 5 targets.",
    ),
]
DesignCauses = Annotated[
    str,
    typer.Option(
        "--causes",
        metavar="NAMES",
        autocompletion=completions.causes,
        help="Interferometer: choose loads that show these causes instead of loads for a calibration. Chain: choose "
        "poses that show these causes too. Axis: choose targets that show these causes alone.",
    ),
]
DesignAccuracy = Annotated[
    bool,
    typer.Option(
        "--accuracy",
        help="Instead: accuracy of the pose by the actuators, or of a chain after a calibration.",
    ),
]
DesignUniqueness = Annotated[
    bool,
    typer.Option(
        "--uniqueness",
        help="Instead: proof of one pose for its readings, or numbers of a chain that data determine.",
    ),
]
DesignTolerances = Annotated[
    bool,
    typer.Option(
        "--tolerances",
        help="Instead: errors of the platform of a force sensor, or of the tip of a chain, by each tolerance.",
    ),
]

# `truing power`.
PowerCauses = Annotated[
    str,
    typer.Option(
        "--causes",
        metavar="NAMES",
        autocompletion=completions.causes,
        help="Ids of causes, separated by commas; default: the whole catalogue.",
    ),
]
PowerDraws = Annotated[
    int, typer.Option("--draws", min=0, max=10000, help="Simulated campaigns per size and effect; 0: theory only.")
]
PowerGross = Annotated[float, typer.Option("--gross", min=0.0, max=0.2, help="Share of points with gross errors.")]
PowerOut = Annotated[
    Path | None,
    typer.Option("--out", metavar="FILE", help=".csv or .parquet file; default: runs/<name>/power.parquet."),
]

# `truing plan`.
PlanStations = Annotated[int, typer.Option("--stations", min=3, max=200, help="Largest number of photographs.")]
PlanWanted = Annotated[
    float | None,
    typer.Option(
        "--wanted", metavar="MM", min=1e-6, help="Stop once the standard deviation of every target is below this."
    ),
]
PlanDistance = Annotated[
    str,
    typer.Option(
        "--distance", metavar="MM,MM", help="Nearest and farthest distance of sharp focus; default: no limit."
    ),
]
PlanElevation = Annotated[
    str,
    typer.Option("--elevation", metavar="DEG,DEG", help="Lowest and highest elevation of stations above the xy-plane."),
]
PlanIncidence = Annotated[
    float, typer.Option("--incidence", min=1.0, max=89.0, help="Largest angle from the normal of a target, degrees.")
]
PlanLeast = Annotated[float, typer.Option("--least", min=0.0, max=1000.0, help="Smallest image of a target, pixels.")]
PlanDirections = Annotated[int, typer.Option("--directions", min=8, max=500, help="Number of directions to try.")]
PlanCamera = Annotated[
    str | None, typer.Option("--camera", metavar="NAME", help="Name of the camera, if the campaign has several.")
]
PlanRun = Annotated[
    Path | None,
    typer.Option(
        "--run",
        metavar="RUN",
        autocompletion=completions.runs,
        help="Run folder from which to take the adjusted camera and its noise.",
    ),
]
PlanNormals = Annotated[
    Path | None,
    typer.Option(
        "--normals", metavar="FILE", help="Table of target normals: body, target, normal_x, normal_y, normal_z."
    ),
]
PlanOut = Annotated[
    Path | None,
    typer.Option("--out", metavar="FILE", help=".csv or .parquet file; default: runs/<name>/plan.csv."),
]

# `truing export`.
ExportRun = Annotated[
    Path,
    typer.Argument(metavar="RUN", autocompletion=completions.runs, help="Folder of a run, such as runs/telescope."),
]
ExportTo = Annotated[
    str,
    typer.Option(
        "--to",
        metavar="FORMS",
        autocompletion=completions.forms,
        help="csv, xlsx, json, controller (default: these four), urdf or dcc, separated by commas.",
    ),
]
ExportOut = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Output folder; default: RUN/exports.")]
ExportCampaign = Annotated[
    Path | None, typer.Option("--campaign", metavar="CAMPAIGN", help="For dcc: folder with campaign.toml.")
]

# `truing report`.
ReportPdf = Annotated[bool, typer.Option("--pdf", help="Print the page to RUN/report.pdf, or to --out.")]
ReportAll = Annotated[bool, typer.Option("--appendix", help="With --pdf: open the appendix too.")]
ReportOut = Annotated[Path | None, typer.Option("--out", metavar="FILE", help="With --pdf: a .pdf file.")]

# `truing compare`.
CompareRuns = Annotated[
    list[Path],
    typer.Argument(metavar="RUN RUN...", autocompletion=completions.runs, help="Folders of runs, in order of time."),
]
CompareOut = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Output folder; default: comparison, next to the first run."),
]
