"""Settings of a lab, from `settings.toml` in it: how the nightly works and what it fits.

Only the settings that a stage uses (`pipeline.nightly.stages`) count for the freshness of its results.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from ingest.toml_files import load_toml
from pipeline.lab.lab import Lab
from schemas.errors import DealabError, LabError

_LARGEST = 1e9
"""Largest limit that can be set: thirty years, or a thousand terabytes."""


@dataclass(frozen=True)
class Settings:
    """What a lab can choose.

    Parameters
    ----------
    deadline_s : longest time that one item may take
    memory_mb : most memory that one worker may take; 0 leaves it to the machine, None is a share of the machine's
    orders : orders of the relaxation models that are fitted
    """

    deadline_s: float = 900.0
    memory_mb: int | None = None
    orders: tuple[int, ...] = (1, 2, 3)

    def choose(self, names: Sequence[str]) -> dict[str, Any]:
        """The settings of these names."""
        return {name: getattr(self, name) for name in names}

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def load_settings(lab: Lab) -> Settings:
    """The lab's settings, or the usual ones. Raises `LabError` for a file that is wrong."""
    if not os.path.lexists(lab.settings):
        return Settings()
    try:
        content = load_toml(lab.settings)
    except DealabError as error:
        raise _refuse(lab, error.problem, error.expected or "a TOML file") from None
    known = {f.name for f in fields(Settings)}
    for key in content:
        if key not in known:
            raise _refuse(lab, f'key "{key[:80]}" is unknown', "one of " + ", ".join(sorted(known)))
    usual = Settings()
    return Settings(
        deadline_s=float(_read_number(lab, content, "deadline_s", usual.deadline_s, low=1)),
        memory_mb=int(_read_number(lab, content, "memory_mb", 0, low=0)) if "memory_mb" in content else None,
        orders=_read_orders(lab, content.get("orders", list(usual.orders))),
    )


def _read_number(lab: Lab, content: dict[str, Any], key: str, usual: float, *, low: float) -> float:
    value = content.get(key, usual)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= _LARGEST:
        raise _refuse(lab, f"{key} is {str(value)[:80]!r}", f"a number from {low:g} to {_LARGEST:g}")
    return value


def _read_orders(lab: Lab, value: Any) -> tuple[int, ...]:
    from schemas.tables import ARMS

    if not isinstance(value, list) or not value or any(type(v) is not int or not 1 <= v <= ARMS for v in value):
        raise _refuse(lab, f"orders is {str(value)[:80]!r}", f"a list of whole numbers from 1 to {ARMS}")
    return tuple(sorted(set(value)))


def _refuse(lab: Lab, problem: str, expected: str) -> LabError:
    return LabError(problem, where=str(lab.settings), expected=expected, remedy="Correct the file or remove it")
