"""[mechanism] of type axis: one rotary or linear axis, and the columns that hold its command and its encoders."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from truing.schemas.mechanism import MechanismSection
from truing.schemas.section import Name, Positive

# What stages that read the rows of an axis declare: columns, how far it stands from its command, noise of encoders.
COLUMNS_OF_AXES = tuple(
    f"mechanism.{name}" for name in ("kind", "command", "motor", "load", "loop", "counts_per_deg", "counts_per_mm")
)
NOISE_OF_COMMANDS = ("noise.command_deg", "noise.command_mm")
NOISE_OF_ENCODERS = tuple(f"noise.{name}_{unit}" for name in ("motor", "load", "measured") for unit in ("deg", "mm"))

_UNIT = {"rotary": "deg", "linear": "mm"}
_COUNTS = "_counts"


class AxisMechanism(MechanismSection):
    """[mechanism] of type axis: which columns of configurations.csv hold its command and its encoders."""

    type: Literal["axis"] = Field(description="one rotary or linear axis")
    kind: Literal["rotary", "linear"] = Field(description="rotary: angles, in degrees; linear: lengths, in mm")
    command: Name = Field(description="column of where the axis was sent: ..._deg, ..._mm or ..._counts")
    motor: Name | None = Field(None, description="column of the encoder at the motor")
    load: Name | None = Field(None, description="column of the encoder at the load, behind the transmission")
    loop: Literal["motor", "load"] = Field(
        "motor", description="the encoder that the controller holds to the command, recorded or not"
    )
    counts_per_deg: Positive | None = Field(None, description="rotary: counts of columns that end in _counts")
    counts_per_mm: Positive | None = Field(None, description="linear: counts of columns that end in _counts")

    @property
    def unit(self) -> str:
        """The unit of the axis in tables: deg or mm."""
        return _UNIT[self.kind]

    @property
    def columns(self) -> dict[str, str]:
        """The columns that the section names, by what they hold: command, motor, load."""
        named = {"command": self.command, "motor": self.motor, "load": self.load}
        return {what: column for what, column in named.items() if column is not None}

    @property
    def counts_per_unit(self) -> float | None:
        """Counts per degree or per mm; None where no column is in counts."""
        return self.counts_per_deg if self.kind == "rotary" else self.counts_per_mm

    @model_validator(mode="after")
    def _columns_fit_the_kind(self) -> AxisMechanism:
        unit = _UNIT[self.kind]
        for what, column in self.columns.items():
            if not column.endswith((f"_{unit}", _COUNTS)):
                raise ValueError(f"a column ..._{unit} or ...{_COUNTS} as {what} of a {self.kind} axis, not {column}")
            if column.endswith(_COUNTS) and self.counts_per_unit is None:
                raise ValueError(f"counts_per_{unit}, since column {column} is in counts")
        if len(set(self.columns.values())) < len(self.columns):
            raise ValueError("a column of its own for each of command, motor and load")
        other = self.counts_per_mm if self.kind == "rotary" else self.counts_per_deg
        if other is not None:
            raise ValueError(f"counts_per_{unit} for a {self.kind} axis")
        return self
