"""What of the raw files is no recording, and why: a line for each file, or one for many that are passed over alike.

Every file of a raw folder is a recording, a data file without a mapping, or in one of these lines. What plainly holds no
data (licences, pictures, programs) is counted in one line for each folder that was given; of what may hold some, the first
files of a kind have lines of their own. Does not belong here: the walk over the files (`ingest.discover`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ingest.formats import UNREAD
from schemas.visible import shown

_LINES_EACH = 20
"""Files that have lines of their own among those that are passed over for the same reason; the others are counted."""
_NAMED_EACH = 3
"""Files that the line of those without data names of each kind."""
_DOCUMENTS = ("readme", "licence", "license", "changes", "changelog", "notes", "copying", "citation")
"""Beginnings of names of texts that are no data."""
_OF_DOCUMENTS = ("", ".txt")
"""Endings of texts that are documents where their name begins so; a table is data, whatever its name."""
_HIDDEN = "hidden or temporary"
_OURS = ".dealab"
"""Beginning of the names of hidden files that dealab itself leaves among raw ones."""
_NO_DATA: Mapping[str, str] = {
    **dict.fromkeys(
        (".md", ".rst", ".pdf", ".doc", ".docx", ".odt", ".rtf", ".tex", ".bib", ".htm", ".html", ".ppt", ".pptx", ".odp"),
        "documents",
    ),
    **dict.fromkeys(
        (".png", ".jpg", ".jpeg", ".gif", ".bmp", ".tif", ".tiff", ".svg", ".webp", ".heic", ".ico", ".eps", ".psd"),
        "pictures",
    ),
    **dict.fromkeys((".mp4", ".avi", ".mov", ".mkv", ".wmv", ".cine", ".webm"), "films"),
    **dict.fromkeys(
        (".py", ".pyc", ".ipynb", ".m", ".r", ".rmd", ".jl", ".c", ".cpp", ".h", ".js", ".css", ".sh", ".bat", ".ps1", ".vi",
         ".lvproj", ".exe", ".dll", ".so", ".slx", ".mlx", ".ino"),
        "programs",
    ),
    **dict.fromkeys((".ini", ".cfg", ".yaml", ".yml", ".lnk", ".url", ".lock"), "settings"),
    **dict.fromkeys((".sha256", ".sha1", ".md5", ".sig", ".asc.sig"), "checksums"),
    ".tdms_index": "indexes of TDMS files",
}  # fmt: skip
"""Endings of files that hold no measurements that a table could be made of, with what they are."""
_NAMES: Mapping[str, str] = {
    "sha256sums": "checksums",
    "md5sums": "checksums",
    "thumbs.db": "settings",
    "makefile": "programs",
}
"""The same by whole names."""
_TEXT_READS = "where it is text, `dealab add FILE` drafts a mapping for it; else export it as CSV, MAT, HDF5 or MCAP"
STRAY_TOML = (
    "a TOML that belongs to nothing here: passed over; a mapping has the whole name of its file and .toml (run7.csv.toml),"
    " or is recordings.toml, and a rig's file lies in a folder rigs"
)


@dataclass(frozen=True)
class Passed:
    """A file, or several, that the night passes over: `place` says which, `why` the rest of the line."""

    place: str
    why: str

    def __str__(self) -> str:
        return f"{self.place}: {self.why}"


def is_document(path: Path) -> bool:
    """Whether a name is that of a text that comes with data, such as `README.txt`."""
    return path.suffix.lower() in _OF_DOCUMENTS and path.name.lower().startswith(_DOCUMENTS)


def find_kind_without_data(path: Path) -> str | None:
    """What a file is whose name says that it holds no data; None for every other one."""
    if is_document(path):
        return "documents"
    return _NAMES.get(path.name.lower(), _NO_DATA.get(path.suffix.lower()))


def explain_unread(path: Path) -> str:
    """Why a file whose ending tells no format of ours is passed over, and what to do about it."""
    ending = path.suffix.lower()
    if ending in UNREAD:
        return f"a format that is not read: passed over; {UNREAD[ending]}"
    what = f"an unknown format ({shown(ending[:20])})" if ending else "an unknown format (its name has no ending)"
    return f"{what}: passed over; {_TEXT_READS}"


@dataclass
class Tally:
    """What a walk passes over: the lines that are said at once, and at its end those for many files together."""

    _plain: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    _plain_counts: dict[tuple[str, str], int] = field(default_factory=dict)
    _counts: dict[str, int] = field(default_factory=dict)
    _more: dict[str, str] = field(default_factory=dict)

    def take_plain(self, path: Path, kind: str, root: str) -> None:
        """Counts a file without data."""
        names = self._plain.setdefault(root, {}).setdefault(kind, [])
        if len(names) < _NAMED_EACH:
            names.append(shown(path.name[:60]))
        self._plain_counts[root, kind] = self._plain_counts.get((root, kind), 0) + 1

    def take_hidden(self, name: str, root: str) -> None:
        """Counts a hidden or temporary file or folder."""
        if not name.startswith(_OURS):
            self.take_plain(Path(name), _HIDDEN, root)

    def take(self, place: str, why: str) -> Passed | None:
        """The line of a file that is passed over; None where its reason has had lines enough and it is counted."""
        self._counts[why] = number = self._counts.get(why, 0) + 1
        if number <= _LINES_EACH:
            return Passed(place, why)
        self._more.setdefault(why, place)
        return None

    def close(self) -> Iterator[Passed]:
        """The lines for many files together."""
        for why, place in self._more.items():
            more = self._counts[why] - _LINES_EACH
            yield Passed(place, why) if more == 1 else Passed(f"{place} and {more - 1} more", why)
        for root, kinds in self._plain.items():
            parts = []
            for kind, names in sorted(kinds.items()):
                number = self._plain_counts[root, kind]
                told = ", ".join(names) + (", …" if number > len(names) else "")
                parts.append(f"{kind} {number} ({told})")
            yield Passed(root, f"files that are no data: passed over: {', '.join(parts)}")
