"""What every section of campaign.toml is made of: closed tables, and numbers within bounds."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from schemas.column import LARGEST

Positive = Annotated[float, Field(gt=0.0, le=LARGEST, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False)]
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
# What a person types has four digits or so.
TYPED = 1e-3


class Section(BaseModel):
    """A table of campaign.toml: immutable, and closed to keys that it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)
