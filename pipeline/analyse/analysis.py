"""The result of analysing one item, and how a step that fails becomes data in it."""

from __future__ import annotations

import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from schemas.errors import DealabError, PremiseError

if TYPE_CHECKING:
    import pyarrow as pa

Given = ParamSpec("Given")
Value = TypeVar("Value")


@dataclass
class Analysis:
    """Rows by table, results that later stages take in full, and what could not be done.

    Parameters
    ----------
    tables : rows by table, in pieces
    carried : results for the later stages
    notes : what the data could not carry, which is no fault of anyone, and what is worth knowing
    missing : of the notes those that say why a step has no value
    premises : of what is missing what follows from a recording of another kind than its protocol says
    problems : what somebody has to look at
    failures : unexpected errors with their tracebacks, `summary` line first
    """

    tables: dict[str, list[pa.Table]] = field(default_factory=dict)
    carried: list[Any] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    premises: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    def attempt(
        self, what: str, step: Callable[Given, Value], /, *args: Given.args, **options: Given.kwargs
    ) -> Value | None:
        """The step's value for the arguments; None where it cannot be had, which is then noted.

        Raises
        ------
        MemoryError
            Memory ends. No other error escapes.
        """
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("default", RuntimeWarning)
                value = step(*args, **options)
        except DealabError as error:
            self.lack([f"{what}: {error}"])
            if isinstance(error, PremiseError):
                self.premises.append(error.shortcoming)
            return None
        except MemoryError:
            raise
        except Exception as error:
            self.failures.append(f"{what}: {type(error).__name__}: {error}\n{traceback.format_exc()}")
            return None
        self.notes += sorted({f"{what}: numerical warning: {w.message}" for w in caught})
        return value

    def add(self, tables: Mapping[str, pa.Table]) -> None:
        """Takes rows; several pieces of one table are joined at the end."""
        for name, rows in tables.items():
            self.tables.setdefault(name, []).append(rows)

    def carry(self, *results: Any) -> None:
        self.carried += results

    def lack(self, texts: Sequence[str]) -> None:
        """Takes why a step has no value."""
        self.missing += texts
        self.notes += texts

    def note(self, texts: Sequence[str]) -> None:
        self.notes += texts

    def joined(self) -> dict[str, pa.Table]:
        """One arrow table per table that has rows."""
        import pyarrow as pa

        return {name: pa.concat_tables(parts) for name, parts in self.tables.items()}
