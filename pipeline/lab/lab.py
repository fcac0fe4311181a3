"""The lab folder: where everything that the pipeline makes lies. Does not belong here: what the files hold."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from schemas.errors import LabError

if TYPE_CHECKING:
    from pathlib import Path

DEFAULT_LAB = "lab"


class Lab:
    """A lab and its paths. What stands in its database is asked through `pipeline.Lab`, which is this with queries.

    A plain class that imports `pathlib` when it is made: with it and `dataclasses`, `dealab --help` would take half as
    long again.
    """

    __slots__ = ("folder",)

    def __init__(self, folder: str | os.PathLike[str] = DEFAULT_LAB) -> None:
        from pathlib import Path

        self.folder = Path(folder)

    def __repr__(self) -> str:
        return f"Lab({str(self.folder)!r})"

    @property
    def database(self) -> Path:
        """The published snapshot; replaced whole, never opened for writing."""
        return self.folder / "results.duckdb"

    @property
    def samples_folder(self) -> Path:
        return self.folder / "samples"

    @property
    def reports(self) -> Path:
        return self.folder / "reports"

    @property
    def quarantine(self) -> Path:
        return self.folder / "quarantine"

    @property
    def annotations(self) -> Path:
        """What people say about recordings, one JSON object a line, only ever appended to."""
        return self.folder / "annotations.jsonl"

    @property
    def settings(self) -> Path:
        return self.folder / "settings.toml"

    @property
    def lock(self) -> Path:
        return self.folder / ".lock"

    @property
    def work(self) -> Path:
        """Results that are finished and not yet published, and whatever is being written; empty between nights."""
        return self.folder / ".work"

    @property
    def ledger(self) -> Path:
        """What a night that is at work knows; gone with it."""
        return self.work / "ledger.sqlite"

    @property
    def journal(self) -> Path:
        return self.work / "journal"

    @property
    def staging(self) -> Path:
        """Samples of recordings that are not yet accepted."""
        return self.work / "samples"

    def staged(self, sha256: str) -> Path:
        """Samples of a content that is not yet accepted."""
        return self.staging / f"{sha256}.parquet"

    @property
    def remote(self) -> Path:
        """What stands for raw folders behind URLs: their TOML files, and the recordings that are being read."""
        return self.folder / ".remote"

    def create(self) -> None:
        """Makes the folder. Raises `LabError` where that is impossible."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise LabError(
                f"the lab cannot be made: {error.strerror}",
                where=str(self.folder),
                remedy="Choose another folder with --lab",
            ) from None

    def require_database(self) -> Path:
        """The published database; `LabError` with the remedy where there is none."""
        if not self.database.is_file():
            raise LabError(
                "no published database here",
                where=str(self.folder),
                remedy="Run `dealab nightly RAW --lab LAB` first, or name another lab with --lab",
            )
        return self.database
