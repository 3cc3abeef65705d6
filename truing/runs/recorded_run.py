"""A recorded run: tables as pandas, figures as plotly objects, verdict, and the extended model."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import pyarrow as pa
import pyarrow.parquet as pq

from truing.runs.page_parts import provenance_of
from truing.schemas.artifact import checked_table
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.memory import raise_shortage
from truing.schemas.near_names import did_you_mean
from truing.schemas.settings_text import parsed_toml, read_settings_text, regular_size

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

    from truing.estimation.sensor.calibrated_sensor import CalibratedSensor
    from truing.report.page import PageHead, ReportSection
    from truing.runs.run_frames import Poses
    from truing.simulation.axis.extended_model import ExtendedAxis
    from truing.simulation.bench.extended_model import ExtendedSensor
    from truing.simulation.mechanisms.chains.extended_model import ExtendedChain
    from truing.simulation.mechanisms.extended_model import ExtendedModel

_PROVENANCE = {"units", "stage", "digest", "software_version", "campaign"}


class PageFigures(dict[str, "go.Figure"]):
    """Figures by name; a wrong name is answered by close ones."""

    def __missing__(self, name: str) -> NoReturn:
        raise KeyError(f"{name}: this page has {', '.join(self)}{did_you_mean(name, list(self))}")


@dataclass(frozen=True, repr=False)
class Run(Mapping[str, "pd.DataFrame"]):
    """Tables of a run by artifact name, read on first access.

    The ``attrs`` of each table: ``units`` by column, and its origin (stage, digest, software_version, campaign).
    """

    folder: Path
    files: Mapping[str, Path]  # by artifact name, tables alone
    campaign: str
    _read: dict[str, pa.Table] = field(default_factory=dict, repr=False, compare=False)

    def __getitem__(self, name: str) -> pd.DataFrame:
        """Return a fresh copy of a table; raises KeyError if the run has none of this name."""
        frame, origin = self.table(name).to_pandas(), self.origin(name)
        frame.attrs |= {**origin, "units": json.loads(origin["units"])}
        return frame

    def __iter__(self) -> Iterator[str]:
        return iter(self.files)

    def __len__(self) -> int:
        return len(self.files)

    def table(self, name: str) -> pa.Table:
        """Return a table as Arrow; raises KeyError for an unknown name, ValueError if it violates its schema."""
        if name not in self.files:
            raise KeyError(f"{name}: this run has {', '.join(self.files)}{did_you_mean(name, self.files)}")
        if name not in self._read:
            self._read[name] = checked_table(self.files[name], ARTIFACTS[name])
        return self._read[name]

    def origin(self, name: str) -> dict[str, str]:
        """Return the origin of a table: stage, digest, software_version, campaign, and remarks of its stage."""
        return provenance_of(self.table(name).schema)

    def poses(self, body: str | None = None) -> Poses:
        """Return rotation, position and 6x6 covariance of every pose and body, or of one body.

        These are the poses that later stages use. Raises KeyError for an unknown body, and without poses.
        """
        from truing.runs.run_frames import poses_of

        motions = poses_of(self["poses"])
        return motions if body is None else motions.of(body)

    def causes(self) -> pd.DataFrame:
        """Return the causes that were found or suspected, a row per parameter with value, sigma and unit.

        Raises KeyError if nothing was diagnosed.
        """
        from truing.runs.run_frames import causes_of

        return causes_of(self["diagnosis"])

    def parameters(self) -> pd.DataFrame:
        """Return the identified parameters, a row each with value, standard and expanded uncertainty, and unit."""
        from truing.runs.run_frames import parameters_of

        return parameters_of({name: self[name] for name in ("uncertainty", "chain_parameters") if name in self})

    def __repr__(self) -> str:
        """Return the campaign, its folder, and the state and explanation of each section."""
        from truing.runs.run_frames import verdict_text

        verdict = verdict_text(self["verdict"]) if "verdict" in self else "no verdict yet: the stage report is missing"
        return f"{self.campaign}: a run with {len(self)} tables in {self.folder}\n{verdict}"

    def _repr_html_(self) -> str:
        """Return the verdict as HTML, as notebooks show it."""
        from truing.runs.run_frames import verdict_html

        return verdict_html(self.campaign, self.verdict, len(self))

    @property
    def verdict(self) -> pd.DataFrame:
        """State, reason and explanation of the campaign (first row) and of each section, as on the page."""
        if "verdict" in self:
            return self["verdict"]
        from truing.runs.page_parts import verdict_table

        return verdict_table({name: self.table(name) for name in self.files}).to_pandas()

    @property
    def verdicts(self) -> tuple[tuple[str, str], ...]:
        """Sentences at the top of the page, each with its mark: found, fail, warn, pass or none."""
        return self._page[0].verdicts

    @property
    def sections(self) -> list[ReportSection]:
        """Sections of the page, in order."""
        return self._page[1]

    @cached_property
    def figures(self) -> dict[str, go.Figure]:
        """Figures of the page by section and index, such as ``evidence-0``; KeyError with close names for others."""
        from truing.report.page import all_of

        drawn = ((section.id, figures) for section in all_of(self.sections) if (figures := section.figures))
        return PageFigures((f"{name}-{k}", figure) for name, figures in drawn for k, (figure, _) in enumerate(figures))

    @cached_property
    def model(self) -> ExtendedModel | ExtendedSensor | ExtendedAxis | ExtendedChain | None:
        """Extended model for `predict_poses`, `predict_readings` or `predict_tip`; None where the run has none."""
        path = self.folder / ARTIFACTS["model"].file
        if not path.is_file():
            return None
        from truing.simulation.axis.extended_model import is_axis, read_axis
        from truing.simulation.bench.extended_model import is_sensor, read_sensor
        from truing.simulation.mechanisms.chains.extended_model import is_chain, read_chain
        from truing.simulation.mechanisms.extended_model import read_model

        text = read_settings_text(path)
        document = parsed_toml(text)
        if "model" not in document:
            return None  # the stage was not evaluated, and says so in the file
        if is_axis(document):
            return read_axis(text)
        if is_chain(document):
            return read_chain(text)
        return read_sensor(text) if is_sensor(document) else read_model(text)

    @cached_property
    def sensor(self) -> CalibratedSensor | None:
        """Calibrated force sensor, whose `wrench` takes signals; None where the run calibrated none."""
        from truing.estimation.sensor.calibrated_sensor import sensor_from

        path = self.folder / ARTIFACTS["sensor"].file
        return sensor_from(parsed_toml(read_settings_text(path))) if path.is_file() else None

    @cached_property
    def _page(self) -> tuple[PageHead, list[ReportSection]]:
        from truing.runs.page_parts import page_parts

        return page_parts(self.campaign, {name: self.table(name) for name in self.files})


def load(folder: str | Path) -> Run:
    """Open the folder of a run.

    Raises FileNotFoundError if it holds no table of a run, ValueError if a table is damaged, or written by a later
    version of truing.
    """
    folder = Path(folder)
    artifacts = {
        name: (path, facts) for path in sorted(folder.glob("*.parquet")) for name, facts in _artifact_provenance(path)
    }
    if not artifacts:
        beside = (
            [sibling.name for sibling in folder.parent.iterdir() if sibling.is_dir()] if folder.parent.is_dir() else []
        )
        near = "" if folder.is_dir() else did_you_mean(folder.name, beside)
        raise FileNotFoundError(
            f"{folder}: found no table of a run, expected a folder that `truing run` has filled{near}"
        )
    names = [name for name in ARTIFACTS if name in artifacts]
    campaigns = {artifacts[name][1].get("campaign", "") for name in names}
    return Run(folder, {name: artifacts[name][0] for name in names}, ", ".join(sorted(campaigns)))


def _artifact_provenance(path: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the artifact name and provenance of a file; nothing if it is no artifact."""
    known = {name for name, artifact in ARTIFACTS.items() if artifact.file == path.name}
    if not known:
        return
    try:
        regular_size(path)
        facts = provenance_of(pq.read_schema(path))
    except (OSError, pa.ArrowException, UnicodeError) as error:
        raise_shortage(error)
        raise ValueError(f"{path.name}: expected an undamaged Parquet file") from None
    if (name := facts.get("schema", "")) in known:
        _check_provenance(path.name, facts, ARTIFACTS[name].version)
        yield name, facts


def _check_provenance(file: str, facts: dict[str, str], version: int) -> None:
    """Raise ValueError if the provenance of a table is incomplete or of a later version."""
    try:
        found, reported = (
            int(facts["schema_version"]),
            facts.keys() >= _PROVENANCE and isinstance(json.loads(facts["units"]), dict),
        )
    except (KeyError, ValueError, RecursionError):
        found, reported = version, False
    if not reported:
        raise ValueError(f"{file}: found no complete provenance, expected a table that a run has written")
    if found > version:
        by = f"truing {facts['software_version']}"
        raise ValueError(f"{file}: found version {found} of its schema, by {by}; expected {version} at most")
