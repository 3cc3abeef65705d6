"""A project of small stages around the real pipeline and schemas, run by the real command line."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from tests.pipeline.warm_python import WarmPython

PROJECT = Path(__file__).resolve().parents[2]
_LONG_AGO_S = 1_000_000_000

# Rooms next to `truing` are its packages, as an installation makes them.
_ONE_NAME = '__version__ = "0"\n__path__.append(__path__[0].removesuffix("truing"))\n'
_DECLARED = "from truing.stages.declaration import Stage\n\nDECLARATION = Stage({!r}, (), ({!r},), (), {!r})\n"
# They are listed, and no campaign of this project has photographs.
OF_PHOTOGRAPHS = {
    "images": _DECLARED.format("images", "image_points", "finds targets"),
    "bundle": _DECLARED.format("bundle", "object_points", "adjusts rays"),
}

STAGES = {
    "ingest": """
import csv
import pyarrow as pa
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.declaration import Outcome, Stage

DECLARATION = Stage("ingest", (), ("observations", "survey?", "exclusions"), ("files",), "reads points.csv")


def run(tables, settings, progress, source):
    settings.files
    rows = list(csv.DictReader((source.folder / "points.csv").open(newline="")))
    schema = ARTIFACTS["observations"].arrow_schema("int64")
    counted = []

    def batches():
        for number, row in enumerate(rows, start=2):
            if row["x_mm"] == "nan":
                raise CampaignFaults([Fault("points.csv", "a finite number", row=number, column="x_mm", value="nan")])
            counted.append(row)
            exact = {"pose": int(row["pose"]), "body": row["body"], "target": row["target"]}
            values = {**exact, **{k: float(row[k]) for k in ("x_mm", "y_mm", "z_mm")}}
            values |= dict.fromkeys(("sigma_x_mm", "sigma_y_mm", "sigma_z_mm"))
            yield pa.RecordBatch.from_pylist([values], schema=schema)

    class Late:
        def __str__(self):
            return f"{len(counted)} points"

    left = {"observations": pa.RecordBatchReader.from_batches(schema, batches())}
    if (source.folder / "targets.csv").exists():
        left["survey"] = ARTIFACTS["survey"].empty()
    left["exclusions"] = ARTIFACTS["exclusions"].empty()
    return Outcome(left, Late(), "nothing", "no fault")
""",
    "qa": """
import pyarrow as pa
import pyarrow.compute as pc
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.declaration import Outcome, Stage

DECLARATION = Stage("qa", ("observations",), ("qa",), ("qa.false_alarm",), "checks the points")


def run(tables, settings, progress):
    largest = pc.max(tables["observations"]["x_mm"]).as_py()
    verdict = "fail" if largest > 900 * (1 - settings.qa.false_alarm) else "pass"
    row = {"check": "size", "subject": None, "value": largest, "limit": 900.0, "unit": "mm"}
    row |= {"verdict": verdict, "message": "largest coordinate"}
    table = pa.Table.from_pylist([row], schema=ARTIFACTS["qa"].arrow_schema())
    return Outcome({"qa": table}, "points", "nothing", verdict, ("size",) if verdict == "fail" else ())
""",
    "pose": """
import os
import time
import pyarrow as pa
import pyarrow.compute as pc
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.declaration import Outcome, Stage

DECLARATION = Stage("pose", ("observations", "survey?"), ("poses", "residuals"), ("noise.point_mm",), "fits")


def run(tables, settings, progress):
    from truing.estimation.mean import mean

    trouble = os.environ.get("FAKE_TROUBLE", "")
    if trouble.startswith("pause"):
        open("pausing", "w").close()
        time.sleep(float(trouble.removeprefix("pause")))
    if trouble == "crash":
        raise RuntimeError("no such luck")
    if trouble == "vanish" and 666.0 in tables["observations"]["x_mm"].to_pylist():
        os.kill(os.getpid(), 9)
    if trouble == "undeclared":
        settings.diagnosis.false_alarm
    if trouble == "memory":
        raise MemoryError("Unable to allocate 7.45 TiB for an array")
    if trouble == "mapping":
        raise ImportError("libblas.so: failed to map segment from shared object")
    if trouble == "full":
        raise OSError(28, "No space left on device", "residuals.parquet")
    progress(1, 1, "points")
    seen = tables["observations"]
    shift = mean(seen["x_mm"].to_pylist()) * settings.noise.point_mm
    rows = [
        {"pose": row["pose"], "body": row["body"], "target": row["target"], "dx_mm": row["x_mm"] - shift,
         "dy_mm": 0.0, "dz_mm": 0.0, "weight": 1.0, "rejected": False, "reason": None}
        for row in seen.to_pylist()
    ]
    residuals = pa.Table.from_pylist(rows, schema=ARTIFACTS["residuals"].arrow_schema())
    if trouble == "schema":
        residuals = residuals.drop_columns(["dz_mm"])
    return Outcome({"poses": ARTIFACTS["poses"].empty(), "residuals": residuals}, "points", "nothing", f"{shift:.3f}")
""",
    "deformation": """
import pyarrow as pa
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.declaration import Outcome, Stage

DECLARATION = Stage(
    "deformation", ("residuals",), ("deformation", "deformation_models", "deformation_errors"),
    ("mechanism.type",), "bends",
)


def run(tables, settings, progress):
    rows = [{"pose": r["pose"], "leg": 1, "delta_rho_mm": r["dx_mm"], "delta_bz_um": 0.0, "sigma_um": 1.0}
            for r in tables["residuals"].to_pylist()]
    table = pa.Table.from_pylist(rows, schema=ARTIFACTS["deformation"].arrow_schema())
    empty = {name: ARTIFACTS[name].empty() for name in ("deformation_models", "deformation_errors")}
    return Outcome({"deformation": table, **empty}, "rows", "nothing", settings.mechanism.type)
""",
    "diagnose": """
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.declaration import Outcome, Stage

DECLARATION = Stage(
    "diagnose", ("qa", "deformation"), ("diagnosis", "model"), ("diagnosis.false_alarm",), "names the cause"
)


def run(tables, settings, progress):
    model = f"[effects]\\nrows = {tables['deformation'].num_rows}\\nfalse_alarm = {settings.diagnosis.false_alarm}\\n"
    return Outcome({"diagnosis": ARTIFACTS["diagnosis"].empty(), "model": model}, "rows", "nothing", "nothing found")
""",
    "calibrate": """
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.declaration import Outcome, Stage

DECLARATION = Stage("calibrate", ("deformation_models",), ("calibration",), ("mechanism.tolerance",), "identifies")


def run(tables, settings, progress):
    return Outcome({"calibration": ARTIFACTS["calibration"].empty()}, "models", "nothing", "nothing identified")
""",
    "uncertainty": """
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.declaration import Outcome, Stage

LEFT = ("uncertainty", "uncertainty_budget")
DECLARATION = Stage("uncertainty", ("observations",), LEFT, ("noise.load_n",), "states")


def run(tables, settings, progress):
    return Outcome({name: ARTIFACTS[name].empty() for name in LEFT}, "points", "nothing", "nothing stated")
""",
    "report": """
from truing.stages.declaration import Outcome, Stage

DECLARATION = Stage(
    "report", ("observations", "survey?", "qa", "residuals", "diagnosis", "model"), ("report",), ("requirement",),
    "tells",
)


def run(tables, settings, progress, source=None):
    page = f"<!doctype html><html><body>{tables['observations'].num_rows} -- {settings.requirement.x_mm}</body></html>"
    return Outcome({"report": page}, "all", "nothing", "1 page")
""",
}

_PROSPECTS = """
from collections import namedtuple

CampaignContents = namedtuple("CampaignContents", "tables targets is_photographed given names")


def prospects(settings, found):
    return ()


def nothing_evaluated(found):
    return False


def has_repeats(settings, found):
    return False
"""

# What the page of all campaigns needs of the real project.
_OF_THE_PAGE = (
    *(
        f"truing/report/{name}.py"
        for name in ("__init__", "all_campaigns", "column_heads", "numbers", "page", "reference")
    ),
    *(f"truing/belonging/{name}.py" for name in ("__init__", "relation")),
)

CAMPAIGN = """# a comment
[campaign]
name = "bench"
kind = "photogrammetry"

[noise]
point_mm = 0.005

[diagnosis]
false_alarm = 0.05
"""

POINTS = """pose,body,target,x_mm,y_mm,z_mm
1,base,A,1.0,2.0,3.0
1,base,B,4.0,5.0,6.0
2,base,A,1.5,2.5,3.5
"""


@dataclass(frozen=True)
class FakeProject:
    """The tiny project, one campaign, and a working folder."""

    root: Path
    campaign: Path
    cwd: Path
    warm: WarmPython | None = None

    @property
    def out(self) -> Path:
        """Default folder of a run."""
        return self.cwd / "runs" / "bench"

    def command(self, *words: str) -> list[str]:
        """The command line as a process's arguments."""
        return [sys.executable, "-m", "pipeline", *words]

    def environment(self, trouble: str = "") -> dict[str, str]:
        """The environment in which the tiny project is the one that is imported."""
        return {**os.environ, "PYTHONPATH": str(self.root), "FAKE_TROUBLE": trouble, "OMP_NUM_THREADS": "1"}

    def call(self, *words: str, trouble: str = "") -> subprocess.CompletedProcess[str]:
        """Run a command to its end."""
        if self.warm is not None:
            return self.warm.call(list(words), self.cwd, self.environment(trouble))
        return subprocess.run(
            self.command(*words),
            cwd=self.cwd,
            env=self.environment(trouble),
            capture_output=True,
            text=True,
            check=False,
        )

    def run(self, *words: str, expect: int = 0, trouble: str = "") -> list[str]:
        """`truing run` on the campaign; returns the names of the stages that ran."""
        done = self.call("run", str(self.campaign), *words, trouble=trouble)
        assert done.returncode == expect, done.stdout + done.stderr
        return [name for line in done.stdout.splitlines() if (name := line.split(" ")[0]) in STAGES]

    def standings(self) -> dict[str, str]:
        """`truing stages`: each stage's state and reasons."""
        done = self.call("stages", str(self.campaign))
        assert done.returncode == 0, done.stderr
        return dict(line.split(maxsplit=1) for line in done.stdout.splitlines())

    def edit(self, file: Path, old: str, new: str) -> None:
        """Change a text that must be there."""
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))


def make_fake_project(folder: Path, warm: WarmPython | None) -> FakeProject:
    """Lay the tiny project out in a folder."""
    root = folder / "project"
    for room in ("pipeline", "schemas"):
        # With what Python has compiled, but for what it is just writing.
        shutil.copytree(PROJECT / room, root / room, ignore=shutil.ignore_patterns("*.pyc.*"))
    files = {f"stages/{name}.py": text for name, text in {**STAGES, **OF_PHOTOGRAPHS}.items()}
    files |= {"stages/__init__.py": "", "truing/__init__.py": _ONE_NAME, "truing/formats/__init__.py": ""}
    files |= {
        "stages/evaluable_stages.py": _PROSPECTS,
        "stages/common/__init__.py": "",
        "stages/common/belonging.py": "def failed_relations(tables):\n    return ()\n",
        "stages/probable_mistakes.py": "def attention(settings, found):\n    return ()\n",
        "stages/ingestion/__init__.py": "",
        "stages/ingestion/loading_tables.py": "TABLES = ()\n",
        "truing/estimation/__init__.py": "",
        "truing/estimation/mean.py": "def mean(values):\n    return sum(values) / len(values)\n",
        "truing/estimation/unused.py": "",
    }
    for name in (
        *("stages/declaration.py", "truing/arrays.py", "truing/child_processes.py"),
        *("truing/formats/source.py", "truing/formats/file_search.py", "truing/formats/faultlog.py"),
    ):
        files[name] = (PROJECT / name).read_text()
    for folder_of_page in ("truing/report/rendering", "truing/belonging"):
        (root / folder_of_page).mkdir(parents=True)
    for path in (PROJECT / "truing/report/rendering").iterdir():
        if path.is_file():
            shutil.copy(path, root / "truing/report/rendering")
    for name in _OF_THE_PAGE:
        files[name] = (PROJECT / name).read_text()
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
        os.utime(root / name, (_LONG_AGO_S, _LONG_AGO_S))  # a change of the same size within a second shows
    campaign = folder / "campaign"
    campaign.mkdir()
    (campaign / "campaign.toml").write_text(CAMPAIGN)
    (campaign / "points.csv").write_text(POINTS)
    (folder / "here").mkdir()
    return FakeProject(root, campaign, folder / "here", warm)
