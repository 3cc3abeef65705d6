"""[certificate] of campaign.toml: what a calibration certificate tells that no measurement does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from truing.schemas.section import Day, NotNegative, Section, Temperature, Words

Country = Annotated[str, Field(pattern=r"^[A-Z]{2}$")]
Issuer = Literal["manufacturer", "calibrationLaboratory", "customer", "owner", "other"]


class Contact(Section):
    """[certificate.laboratory], [certificate.customer]: who it is, and where."""

    name: Words | None = Field(None, description="of the laboratory, or of the customer")
    street: Words | None = Field(None, description="with number")
    post_code: Words | None = Field(None, description="of the city")
    city: Words | None = Field(None, description="where it is")
    country: Country | None = Field(None, description="two letters of ISO 3166-1")
    e_mail: Words | None = Field(None, description="for questions")
    phone: Words | None = Field(None, description="for questions")


class Item(Section):
    """[certificate.item], [[certificate.equipment]]: what was calibrated; what it was calibrated with."""

    name: Words | None = Field(None, description="what it is")
    manufacturer: Words | None = Field(None, description="who made it")
    model: Words | None = Field(None, description="by the name of its maker")
    identification: Words | None = Field(None, description="serial or inventory number")
    issuer: Issuer = Field("manufacturer", description="who gave it the number")


class Person(Section):
    """[[certificate.persons]]: who answers for it; the first one signs."""

    name: Words | None = Field(None, description="of the person")
    role: Words | None = Field(None, description="in the laboratory")


class Certificate(Section):
    """[certificate]: what `truing export --to dcc` needs to know and no measurement tells; never needed by a run."""

    number: Words | None = Field(None, description="of the certificate, unique")
    country: Country | None = Field(None, description="where it is issued, two letters of ISO 3166-1")
    location: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] | None = Field(
        None, description="where it was measured"
    )
    begin: Day | None = Field(None, description="first day of the measurement")
    end: Day | None = Field(None, description="last day of the measurement")
    received: Day | None = Field(None, description="day on which the item was received")
    issued: Day | None = Field(None, description="day of issue")
    order: Words | None = Field(None, description="the customer's order")
    laboratory_code: Words | None = Field(None, description="of its accreditation")
    temperature_c: Temperature | None = Field(None, description="of the item, where the campaign has recorded none")
    temperature_within_c: NotNegative | None = Field(None, description="half the range that it stayed within")
    traceability: Words | None = Field(None, description="a sentence on the traceability of the results")
    methods: tuple[Words, ...] = Field((), description="further procedures that were followed, by name")
    laboratory: Contact = Field(Contact(), description="who calibrated it")
    customer: Contact = Field(Contact(), description="who had it calibrated")
    item: Item = Field(Item(), description="what was calibrated")
    persons: tuple[Person, ...] = Field((), description="who answers for it; the first one signs")
    equipment: tuple[Item, ...] = Field((), description="what it was calibrated with")

    def missing(self, *, temperature_known: bool) -> Iterator[str]:
        """Yield every key without which there is no certificate."""
        needed: dict[str, tuple[str, ...]] = {"": ("number", "country", "location", "begin", "end")}
        needed |= {f"{name}.": ("name", "city", "country") for name in ("laboratory", "customer")}
        needed["item."] = ("name", "identification")
        for place, keys in needed.items():
            section = getattr(self, place.rstrip(".")) if place else self
            yield from (f"certificate.{place}{key}" for key in keys if getattr(section, key) is None)
        if not self.persons:
            yield "certificate.persons"
        yield from (f"certificate.persons.{n}.name" for n, one in enumerate(self.persons, 1) if one.name is None)
        for n, one in enumerate(self.equipment, 1):
            keys = ("name", "identification")
            yield from (f"certificate.equipment.{n}.{key}" for key in keys if getattr(one, key) is None)
        if not temperature_known:
            known = ("temperature_c", "temperature_within_c")
            yield from (f"certificate.{key}" for key in known if getattr(self, key) is None)
