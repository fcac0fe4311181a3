"""The lab folder: where everything that the pipeline makes lies. Does not belong here: what the files hold."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

from schemas.errors import LabError
from schemas.visible import quote_path

if TYPE_CHECKING:
    from collections.abc import Iterator
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
    def lock_holder(self) -> Path:
        """Who holds the lock."""
        return self.folder / ".lock-holder.json"

    @property
    def work(self) -> Path:
        """Results that are finished and not yet published, and whatever is being written; empty between nights."""
        return self.folder / ".work"

    @property
    def is_of_one_case(self) -> bool:
        """Its file system keeps one file for names that differ by case only, as those of macOS and Windows do."""
        return self.work.with_name(self.work.name.upper()).exists()

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
        from schemas.database import spell_database

        spell_database(self.database)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise LabError(
                f"the lab cannot be made: {error.strerror}",
                where=str(self.folder),
                remedy="Choose another folder with --lab",
            ) from None

    def refuse_links(self) -> None:
        """Raises `LabError` where something in the lab that is written or emptied is a link, and would be elsewhere."""
        found = next(self._find_links(), None)
        if found is not None:
            raise LabError(
                "a link in the lab, which is neither written through nor emptied",
                where=found,
                expected="files and folders of the lab's own",
                remedy="Remove the link; to keep the lab on another disk, move the whole folder there",
            )

    def _find_links(self) -> Iterator[str]:
        """Links among the files that are written in place, and among the folders."""
        for file in (self.annotations, self.lock, self.lock_holder):
            if file.is_symlink():
                yield str(file)
        waiting = [os.fspath(p) for p in (self.work, self.remote, self.samples_folder, self.reports, self.quarantine)]
        while waiting:
            folder = waiting.pop()
            if os.path.islink(folder):
                yield folder
                continue
            with contextlib.suppress(OSError), os.scandir(folder) as entries:  # a file, or gone meanwhile
                waiting += [entry.path for entry in entries if entry.is_symlink() or entry.is_dir()]

    def spell_command(self, words: str) -> str:
        """A command on this lab as it is typed where it was named, between backticks: `dealab status --lab LAB`."""
        folder = os.fspath(self.folder)
        return f"`dealab {words}`" if folder == DEFAULT_LAB else f"`dealab {words} --lab {quote_path(folder)}`"

    def require_database(self) -> Path:
        """The published database; `LabError` with the remedy where there is none."""
        if not self.database.is_file():
            raise LabError(
                "no published database here",
                where=str(self.folder),
                remedy=f"Run {self.spell_command('nightly RAW')} first, or name another lab with --lab",
            )
        return self.database
