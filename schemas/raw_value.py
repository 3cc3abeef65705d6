"""How the numbers of a raw column become those of a table: linear, wrapped, and from an expanded uncertainty."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from truing.schemas.section import Finite, Positive, RawText, Section, is_raw_text


def _is_raw_column(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise ValueError("the raw column's name in quotation marks, or its position from 1")
    return value if isinstance(value, int) else is_raw_text(value)


RawColumn = Annotated[str | int, BeforeValidator(_is_raw_column)]


class RawValue(Section):
    """One raw column and what its numbers stand for: ``value = raw * scale + offset``, then wrapped, then divided by
    ``coverage``; all in ``unit``, from which the value is brought into that of the table's column."""

    name: RawColumn | None = Field(None, description="raw name, or position from 1; absent: the column's own name")
    unit: RawText | None = Field(None, description="unit that the value is in")
    scale: Finite = Field(1.0, description="factor of the raw number; -1 turns the direction round")
    offset: Finite = Field(0.0, description="added to the scaled number, in `unit`")
    modulo: Positive | None = Field(None, description="period that the value is wrapped into, in `unit`")
    lowest: Finite | None = Field(None, description="least value after wrapping, in `unit`; absent: 0")
    coverage: Positive | None = Field(
        None, description="coverage factor k of an expanded uncertainty U = k sigma, which is divided by it"
    )

    @model_validator(mode="after")
    def _makes_sense(self) -> RawValue:
        if self.scale == 0.0:
            raise ValueError("a scale other than 0, which would make all values alike")
        if self.lowest is not None and self.modulo is None:
            raise ValueError("lowest together with modulo, the period")
        return self

    @property
    def is_plain(self) -> bool:
        """Whether numbers are taken as they are, their unit apart."""
        return (self.scale, self.offset, self.modulo, self.coverage) == (1.0, 0.0, None, None)
