"""A crate on disk: a folder, a zip or an .eln, written the same each time, and read with its hashes recomputed."""

from __future__ import annotations

import hashlib
import shutil
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from pipeline.commands.crate.contents import (
    FIGURES_FOLDER,
    MODELS_FOLDER,
    TABLES_FOLDER,
    list_recordings,
    write_report,
    write_results,
)
from pipeline.commands.crate.metadata import (
    DATACITE,
    MANIFEST,
    METADATA,
    PROVENANCE,
    About,
    dump,
    write_datacite,
    write_metadata,
)
from pipeline.lab.lab import Lab
from reports.results import Results
from schemas.errors import UsageError

ARCHIVES = (".zip", ".eln")
_EPOCH = (1980, 1, 1, 0, 0, 0)
_RESULTS = (TABLES_FOLDER, MODELS_FOLDER, FIGURES_FOLDER)
_LARGEST = 2 << 30
"""Bytes that a file of a crate may unfold to, 2 GiB."""

Digests = dict[str, str]


class CrateFiles:
    """Files on their way into a crate: each is written as it comes, with its SHA-256 and size."""

    def __init__(self, target: Path, root: str) -> None:
        self.digests: dict[str, tuple[str, int]] = {}
        self._folder = None if target.suffix.lower() in ARCHIVES else target
        self._prefix = f"{root}/" if target.suffix.lower() == ".eln" else ""
        self._zip = None if self._folder else zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED)
        if self._folder is not None:
            self._folder.mkdir(parents=True)

    def add(self, name: str, content: bytes) -> None:
        """Writes a file."""
        self.digests[name] = hashlib.sha256(content).hexdigest(), len(content)
        if self._zip is not None:
            about = zipfile.ZipInfo(self._prefix + name, _EPOCH)
            about.compress_type, about.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            self._zip.writestr(about, content)
        elif self._folder is not None:
            path = self._folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

    def add_all(self, files: Iterable[tuple[str, bytes]]) -> None:
        """Writes files one by one."""
        for name, content in files:
            self.add(name, content)

    def close(self) -> None:
        """Ends an archive."""
        if self._zip is not None:
            self._zip.close()


def write_crate(lab: Lab, target: Path, about: About, name: str) -> tuple[Digests, str]:
    """Writes a crate to a path where nothing is yet; gives its files' digests and that of its results.

    Parameters
    ----------
    name : of the crate: the folder inside an .eln, and what its title is made from
    """
    with Results(lab.folder) as results:
        runs = results.rows("SELECT * FROM runs ORDER BY run_id")
        recordings = list_recordings(results)
    if not runs:
        raise UsageError("no night is recorded in this lab", expected="a lab with a night")
    run = {
        **runs[-1],
        "started_at": runs[-1]["started_at"].isoformat(),
        "finished_at": runs[-1]["finished_at"].isoformat(),
    }
    files, title = CrateFiles(target, name), f"Results of the lab {name}"
    try:
        files.add_all(write_results(lab))
        digest = digest_results({n: d for n, (d, _) in files.digests.items()})
        files.add_all(write_report(lab))
        files.add(
            DATACITE, dump(write_datacite(about, title, int(run["finished_at"][:4]), run["software_version"] or ""))
        )
        files.add(PROVENANCE, dump(_describe_provenance(run, digest)))
        listed = "".join(f"{d}  {n}\n" for n, (d, _) in sorted(files.digests.items()))
        files.add(MANIFEST, listed.encode())
        files.add(METADATA, dump(write_metadata(about, title, run, recordings, files.digests)))
    finally:
        files.close()
    return {n: d for n, (d, _) in files.digests.items()}, digest


def digest_results(digests: Mapping[str, str]) -> str:
    """One SHA-256 over all tables, models and figures: the same for the same results, wherever they were made."""
    lines = (f"{digests[n]}  {n}\n" for n in sorted(digests) if n.split("/")[0] in _RESULTS)
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _describe_provenance(run: Mapping[str, Any], digest: str) -> dict[str, Any]:
    import platform
    from importlib import metadata

    names = ("numpy", "scipy", "pandas", "pyarrow", "duckdb", "matplotlib")
    return {
        "results_sha256": digest,
        "run": {
            k: run[k] for k in ("run_id", "started_at", "finished_at", "software_version", "code_version", "settings")
        },
        "software": {"python": platform.python_version(), **{n: metadata.version(n) for n in names}},
    }


def read_crate(path: Path) -> dict[str, bytes]:
    """All files of a crate by name; `UsageError` where it is none, or holds names that lead out of it."""
    if path.is_dir():
        found = {
            p.relative_to(path).as_posix(): p.read_bytes()
            for p in sorted(path.rglob("*"))
            if p.is_file() and not p.is_symlink()
        }
    elif zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            entries = [e for e in archive.infolist() if not e.is_dir()]
            if sum(e.file_size for e in entries) > _LARGEST:
                raise UsageError(f"{path}: unfolds to more than 2 GiB", expected="a crate that dealab has written")
            try:
                found = {e.filename: archive.read(e) for e in entries}
            except (zipfile.BadZipFile, RuntimeError) as error:
                raise UsageError(f"{path}: {error}", expected="an archive that is whole") from None
    else:
        raise UsageError(f"{path}: neither a folder nor an archive", expected="a crate: a folder, .zip or .eln")
    roots = [n for n in found if PurePosixPath(n).name == METADATA]
    if not roots:
        raise UsageError(f"{path}: there is no {METADATA} in it", expected="a crate that dealab has written")
    prefix = min(roots, key=len).removesuffix(METADATA)
    return {n.removeprefix(prefix): content for n, content in found.items()}


def compare_digests(files: Mapping[str, bytes]) -> list[str]:
    """A line for each file that is not what the manifest says, is missing, or is not listed."""
    listed: Digests = {}
    for line in files.get(MANIFEST, b"").decode("utf-8", "replace").splitlines():
        digest, _, name = line.partition("  ")
        listed[name] = digest
    if not listed:
        return [f"{MANIFEST}: missing or empty"]
    lines = []
    for name, digest in sorted(listed.items()):
        if name not in files:
            lines.append(f"{name}: missing")
        elif hashlib.sha256(files[name]).hexdigest() != digest:
            lines.append(f"{name}: its SHA-256 is not the one in {MANIFEST}")
    extra = sorted(set(files) - set(listed) - {MANIFEST, METADATA})
    return [*lines, *(f"{name}: not listed in {MANIFEST}" for name in extra)]


def discard(target: Path) -> None:
    """Takes away what was left of a crate that could not be finished."""
    if target.is_dir():
        shutil.rmtree(target)
    else:
        target.unlink(missing_ok=True)
