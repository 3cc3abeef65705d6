"""[files.<table>]: how a laboratory's own export becomes one of the contract's tables, untouched."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class FileMapping(BaseModel):
    """One [files.<table>] entry (or one of several): which raw files, in which format, and which column is what."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    path: str | tuple[str, ...] = Field(description="file or glob, relative to campaign.toml; may lead out of the folder")
    format: Literal["auto", "delimited", "parquet", "ply", "pcd", "xyz", "c3d", "trc"] = "auto"
    separator: str | None = Field(None, description='one character, or "whitespace"; absent: found out')
    header: bool = True
    decimal: Literal[".", ","] = "."
    thousands: str | None = None
    encoding: str = "utf-8"
    comment: str | None = Field(None, description="lines that begin with it are passed over")
    skip_lines: int = Field(0, ge=0)
    columns: dict[str, str | int] = Field(default_factory=dict, description="table column = raw name, or position from 1")
    units: dict[str, str] = Field(default_factory=dict, description="unit of a raw column, where not the table's own")
    unit: str | None = Field(None, description="unit of all coordinates")
    constants: dict[str, str | int | float] = Field(default_factory=dict)
    missing: tuple[str, ...] = Field((), description="values that mean missing")
    from_name: str | None = Field(None, description="regular expression on the file's name; named groups become columns")
