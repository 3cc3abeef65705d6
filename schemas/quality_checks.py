"""All quality checks by kind of campaign, and faults of the limits and acceptances in campaign.toml."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from truing.schemas.axis_checks import OF_AXES, OF_POSITIONS
from truing.schemas.faults import Fault
from truing.schemas.installed import with_installed
from truing.schemas.load_checks import OF_LOADS
from truing.schemas.near_names import did_you_mean, nearest_name
from truing.schemas.point_checks import OF_PHOTOGRAPHS, OF_POINTS
from truing.schemas.quality_check import CheckLimits, Checks, DeclaredCheck, QualityCheck
from truing.schemas.sections import Acceptance, SetLimits

CHECKS: Mapping[str, Checks] = {
    "photogrammetry": {**OF_POINTS, **OF_PHOTOGRAPHS, **OF_AXES},
    "interferometer": {**OF_LOADS, **OF_POSITIONS},
}
# Checks whose failure withholds results; a name that both kinds share means the same in both.
WITHHOLDING: Checks = {name: check for checks in CHECKS.values() for name, check in checks.items() if check.withholds}
ENTRY_POINTS = "truing.checks"  # group of installed packages


def installed_checks(kind: str) -> dict[str, DeclaredCheck]:
    """Checks of installed packages for a kind of campaign, by name; raises ValueError for a name in use."""
    declared_checks: tuple[DeclaredCheck, ...] = ()
    checks_found = with_installed(
        declared_checks,
        ENTRY_POINTS,
        "check",
        lambda installed_check: installed_check.name,
        lambda one: one.kind == kind,
    )
    if twice := sorted({*checks_found} & {*CHECKS[kind]}):
        raise ValueError(f"check {twice[0]}: found in two places, expected one")
    return checks_found


def checks_of(kind: str) -> dict[str, QualityCheck]:
    """All checks of a kind of campaign by name, those of installed packages last."""
    return {
        **CHECKS[kind],
        **{name: installed_check.declared for name, installed_check in installed_checks(kind).items()},
    }


def settable(kind: str) -> dict[str, CheckLimits]:
    """Default limits of the checks whose limits a campaign may set, by name."""
    return {
        name: check.criterion for name, check in checks_of(kind).items() if isinstance(check.criterion, CheckLimits)
    }


def in_force(declared: CheckLimits, set_limits: SetLimits) -> tuple[float | None, float | None]:
    """(warn, fail) of a check: the campaign's limits, else the defaults."""
    return (
        declared.warn if set_limits.warn is None else set_limits.warn,
        declared.fail if set_limits.fail is None else set_limits.fail,
    )


def limit_faults(file: str, kind: str, limits: Mapping[str, SetLimits]) -> Iterator[Fault]:
    """Faults of [qa.limits.<check>]: unknown check, no limit, too large a limit, or a fail limit passed before warn."""
    known = settable(kind) if limits else {}
    for name, limit in limits.items():
        key = f"qa.limits.{name}"
        if name not in known:
            yield Fault(file, _unknown(name, kind), column=key)
            continue
        if limit.warn is None and limit.fail is None:
            yield Fault(file, "warn, fail, or both", column=key)
        yield from _limits_above_most(file, key, known[name], limit)
        warn, fail = in_force(known[name], limit)
        if warn is not None and fail is not None and (fail > warn if known[name].below else fail < warn):
            about_default = "; a limit that is not given has its default" if None in (limit.warn, limit.fail) else ""
            yield Fault(
                file,
                f"fail ({fail:g}) {'at most' if known[name].below else 'at least'} warn ({warn:g}), "
                f"because a failure is worse than a warning{about_default}",
                column=key,
            )


def acceptance_faults(file: str, kind: str, accept: Sequence[Acceptance]) -> Iterator[Fault]:
    """Faults of [[accept]]: checks that this kind of campaign does not have."""
    known = checks_of(kind) if accept else {}
    for number, entry in enumerate(accept, 1):
        if entry.check not in known:
            hint = did_you_mean(entry.check, known) or f"; one of: {', '.join(known)}"
            expected = f"a check of a campaign of kind {kind}{hint}"
            yield Fault(file, expected, column=f"accept.{number}.check", value=entry.check)


def _limits_above_most(file: str, where: str, declared: CheckLimits, set_limits: SetLimits) -> Iterator[Fault]:
    for key, value in (("warn", set_limits.warn), ("fail", set_limits.fail)):
        if value is not None and declared.most is not None and value > declared.most:
            yield Fault(file, f"at most {declared.most:g} ({declared.of})", column=f"{where}.{key}", value=f"{value:g}")


def _unknown(name: str, kind: str) -> str:
    if name in checks_of(kind):
        return (
            "a check with a settable limit; this check is a significance test ([qa] false_alarm) or fails at any size"
        )
    known = settable(kind)
    near = nearest_name(name, known)
    if near is not None:
        return f"a check whose limits can be set; did you mean {near}?"
    return f"a check of a campaign of kind {kind} whose limits can be set, one of: {', '.join(known)}"
