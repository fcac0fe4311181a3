"""Covariates of a laboratory's own naming: anything beside the voltage that a life may depend on, such as a curing time.

A table maps them in `[covariates.<name>]`, a recording has them in its metadata as `covariate_<name>`. Belongs here: what one is and
how metadata write it. Columns of tables are read in `ingest.own_covariates`, regressions are in `pipeline.fit.survival`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from schemas.errors import RefusedError

INVERSE_POWER, EXPONENTIAL_LAW, ARRHENIUS, CATEGORY = "inverse power", "exponential", "arrhenius", "category"
LAWS = (INVERSE_POWER, EXPONENTIAL_LAW, ARRHENIUS, CATEGORY)
"""How a covariate enters ln t: by its logarithm, as it is, by 1/kT of °C, or as names without an order."""
PREFIX, LAW_SUFFIX = "covariate_", "_law"
"""Of keys of metadata: `covariate_cure` is the value of `cure`, `covariate_cure_law` its law."""
LONGEST_NAME = 60
BUILT_IN = ("voltage", "temperature", "humidity", "frequency", "configuration", "electrode", "batch")
"""Names that lives have columns and keys for already."""
_WITH_UNIT = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?:\s+(\S+))?")


@dataclass(frozen=True)
class OwnCovariate:
    """One covariate of one life: a number in `unit`, or a category's name where the `law` is that of categories."""

    name: str
    value: float | str
    law: str
    unit: str = ""

    @property
    def words(self) -> str:
        """As groups of lives are called by it."""
        if isinstance(self.value, str):
            return self.value
        return f"{self.name} {self.value:g} {self.unit}".rstrip()


def check_name(name: str, key: str, where: str) -> str:
    """A name that a covariate may have. Raises `RefusedError` for one that is empty, too long or taken."""
    if name.lower() in BUILT_IN:
        raise RefusedError(
            f"{key}: {name} is no name of your own",
            where=where,
            expected="a name that no column of lives has",
            remedy=f"Map the column as columns.{name.lower()}, or state it under that name in [recording]",
        )
    if not 1 <= len(name.strip()) <= LONGEST_NAME or not name.isprintable() or ":" in name or "," in name:
        raise RefusedError(
            f'{key[:90]}: "{name[:80]}" cannot be a covariate\'s name',
            where=where,
            expected=f"1 to {LONGEST_NAME} characters without comma, colon and control characters",
        )
    return name


def make_covariate(name: str, written: object, law: str | None, unit: str, *, where: str) -> OwnCovariate | None:
    """A covariate from what somebody wrote; None for an empty cell.

    Parameters
    ----------
    written : a number, text, or text such as `3 h`
    law : of `LAWS`; None: numbers enter as they are, other text is a category

    Raises
    ------
    RefusedError
        The law takes numbers, and this is none.
    """
    text = "" if written is None else str(written).strip()
    if not text:
        return None
    if law == CATEGORY:
        return OwnCovariate(name, text, CATEGORY)
    found = _WITH_UNIT.fullmatch(text)
    if found is not None and math.isfinite(float(found[1])):
        return OwnCovariate(name, float(found[1]), law or EXPONENTIAL_LAW, unit or found[2] or "")
    if law is not None:
        raise RefusedError(
            f'{name} is "{text[:80]}"', where=where, expected=f'a number for the {law} law, or law = "{CATEGORY}"'
        )
    return OwnCovariate(name, text, CATEGORY)


def from_metadata(extra: Mapping[str, str], *, where: str = "") -> tuple[OwnCovariate, ...]:
    """The covariates among the keys of metadata that are no keys of the contract. Raises `RefusedError`."""
    given = {key.removeprefix(PREFIX): value for key, value in extra.items() if key.startswith(PREFIX)}
    laws = {name: given[name + LAW_SUFFIX].strip() for name in given if name + LAW_SUFFIX in given}
    found = []
    for name in sorted(given):
        if name.removesuffix(LAW_SUFFIX) in laws and name.endswith(LAW_SUFFIX):
            continue
        law = laws.get(name)
        if law is not None and law not in LAWS:
            raise RefusedError(
                f'{PREFIX}{name}{LAW_SUFFIX} is "{law[:80]}"', where=where, expected="one of " + ", ".join(LAWS)
            )
        one = make_covariate(check_name(name, PREFIX + name, where), given[name], law, "", where=where)
        if one is not None:
            found.append(one)
    return tuple(found)


def as_json(covariates: Iterable[OwnCovariate]) -> str | None:
    """Names with values as the column `covariates` of the table `lifetimes` has them; None where there are none."""
    found = {one.name: one.value for one in covariates}
    return json.dumps(found, ensure_ascii=False, sort_keys=True) if found else None
