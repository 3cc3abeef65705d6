"""[certificate] of campaign.toml: entries of a calibration certificate that are not measured."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from truing.schemas.section import Day, NotNegative, Section, Temperature, Words

Country = Annotated[str, Field(pattern=r"^[A-Z]{2}$")]
Issuer = Literal["manufacturer", "calibrationLaboratory", "customer", "owner", "other"]


class Contact(Section):
    """[certificate.laboratory], [certificate.customer]: name and address."""

    name: Words | None = Field(None, description="name of the laboratory or of the customer")
    street: Words | None = Field(None, description="with number")
    post_code: Words | None = Field(None, description="of the city")
    city: Words | None = Field(None, description="city")
    country: Country | None = Field(None, description="two letters of ISO 3166-1")
    e_mail: Words | None = Field(None, description="for questions")
    phone: Words | None = Field(None, description="for questions")


class Item(Section):
    """[certificate.item], [[certificate.equipment]]: the calibrated item; the equipment used."""

    name: Words | None = Field(None, description="kind of item")
    manufacturer: Words | None = Field(None, description="manufacturer")
    model: Words | None = Field(None, description="model name by the manufacturer")
    identification: Words | None = Field(None, description="serial or inventory number")
    issuer: Issuer = Field("manufacturer", description="who issued the number")


class Person(Section):
    """[[certificate.persons]]: responsible persons; the first one signs."""

    name: Words | None = Field(None, description="name")
    role: Words | None = Field(None, description="role in the laboratory")


class Certificate(Section):
    """[certificate]: data for `truing export --to dcc` that no measurement gives; never needed by a run."""

    number: Words | None = Field(None, description="unique number of the certificate")
    country: Country | None = Field(None, description="country of issue, two letters of ISO 3166-1")
    location: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] | None = Field(
        None, description="place of the measurement"
    )
    begin: Day | None = Field(None, description="first day of the measurement")
    end: Day | None = Field(None, description="last day of the measurement")
    received: Day | None = Field(None, description="day of receipt of the item")
    issued: Day | None = Field(None, description="day of issue")
    order: Words | None = Field(None, description="the customer's order")
    laboratory_code: Words | None = Field(None, description="code of the accreditation")
    temperature_c: Temperature | None = Field(
        None, description="temperature of the item, if the campaign has none recorded"
    )
    temperature_within_c: NotNegative | None = Field(None, description="half the range of the temperature")
    traceability: Words | None = Field(None, description="sentence on the traceability of the results")
    methods: tuple[Words, ...] = Field((), description="names of further procedures that were followed")
    laboratory: Contact = Field(Contact(), description="calibration laboratory")
    customer: Contact = Field(Contact(), description="customer")
    item: Item = Field(Item(), description="calibrated item")
    persons: tuple[Person, ...] = Field((), description="responsible persons; the first one signs")
    equipment: tuple[Item, ...] = Field((), description="equipment used for the calibration")

    def missing(self, *, temperature_known: bool) -> Iterator[str]:
        """Yield every missing key that a certificate requires."""
        needed: dict[str, tuple[str, ...]] = {"": ("number", "country", "location", "begin", "end")}
        needed |= {f"{name}.": ("name", "city", "country") for name in ("laboratory", "customer")}
        needed["item."] = ("name", "identification")
        for prefix, keys in needed.items():
            section = getattr(self, prefix.rstrip(".")) if prefix else self
            yield from (f"certificate.{prefix}{key}" for key in keys if getattr(section, key) is None)
        if not self.persons:
            yield "certificate.persons"
        yield from (f"certificate.persons.{n}.name" for n, person in enumerate(self.persons, 1) if person.name is None)
        for n, entry in enumerate(self.equipment, 1):
            keys = ("name", "identification")
            yield from (f"certificate.equipment.{n}.{key}" for key in keys if getattr(entry, key) is None)
        if not temperature_known:
            known = ("temperature_c", "temperature_within_c")
            yield from (f"certificate.{key}" for key in known if getattr(self, key) is None)
