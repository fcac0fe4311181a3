"""`dealab add`: the mapping of a foreign file, drafted, asked for what it lacks, checked, and written beside it."""

from __future__ import annotations

import shlex
import sys
from argparse import Namespace
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from pipeline.commands.command import ATTENTION, DONE, FAILED, RIGS, Command, argument, parse_path
from schemas.visible import make_safe, quote_path, shown

if TYPE_CHECKING:
    from pathlib import Path

    from ingest.draft import Draft
    from ingest.passed_over import Passed

YES = argument(
    "--yes",
    nargs="*",
    action="extend",
    metavar="KEY=VALUE",
    help="answers, such as specimen_id=P-07 force.unit=mN CH1=voltage, and what the test needs, such as rig_id=rig-a "
    "film_sizes_mm=50x20x0.5 frequency_start_hz=1; for what else is asked, the suggestion is taken",
)
REPLACE = argument("--replace", action="store_true", help="writes a new mapping where there is one already")


def run(arguments: Namespace) -> int:
    files, of_folders = _list_files(arguments.file)
    shared = _find_shared(files, arguments.yes or [])
    states = [
        _add_found(path, arguments, shared) if path in of_folders else add_file(path, arguments, shared=shared)
        for path in files
    ]
    return max(states, default=FAILED)


def _list_files(given: Sequence[Path]) -> tuple[list[Path], set[Path]]:
    """The files, those without a mapping in place of each folder, and which of them were found so."""
    from ingest.discover import UNMAPPED, discover

    files = [path for path in given if not path.is_dir()]
    found: list[Path] = []
    for folder in (path for path in given if path.is_dir()):
        named_otherwise = _list_named_otherwise(folder)
        passed: list[Passed] = []
        new = sorted(
            {*named_otherwise, *(one.path for one in discover([folder], passed.append) if one.state == UNMAPPED)}
        )
        looked_at = {shown(path) for path in named_otherwise}
        for one in passed:
            if one.place not in looked_at:
                print(one, file=sys.stderr)
        if not new:
            print(f"{folder}: no file without a mapping", file=sys.stderr)
        found += new
    return [*files, *found], set(found)


def _list_named_otherwise(folder: Path) -> list[Path]:
    """Texts without a mapping whose ending tells no format: machines name their exports after themselves (`.TRA`)."""
    from ingest.formats import UNREAD
    from ingest.mapping import format_of, own_mapping
    from ingest.passed_over import find_kind_without_data

    found = []
    for path in folder.rglob("*"):
        hidden = any(part.startswith((".", "~$")) for part in path.relative_to(folder).parts)
        known = path.suffix.lower() in (".toml", *UNREAD) or format_of(path) is not None
        if hidden or known or find_kind_without_data(path) or not path.is_file() or own_mapping(path).is_file():
            continue
        with path.open("rb") as file:
            start = file.read(4096)
        if start and b"\x00" not in start:
            found.append(path)
    return found


def _add_found(path: Path, arguments: Namespace, shared: Mapping[Path, Collection[str]]) -> int:
    """As `add_file`, of a file that nobody named: one that is no table, such as a note, is passed over."""
    from schemas.errors import RefusedError

    try:
        return add_file(path, arguments, shared=shared)
    except RefusedError as error:
        print(make_safe(f"{path}: passed over: {error}"), file=sys.stderr)
        return DONE


def _find_shared(paths: Sequence[Path], given: Sequence[str]) -> dict[Path, set[str]]:
    """By file, of several, the answers that are meant for others: `force.scale` for a trace, not for lives."""
    from ingest.answers import find_keys, split_answers

    if len(paths) < 2 or not given:
        return {}
    answers = split_answers(list(given))
    known = {path: find_keys(path, answers) for path in paths if path.is_file()}
    every = set().union(*known.values()) if known else set()
    return {path: every - keys for path, keys in known.items()}


def _ask_person(text: str) -> str:
    """A line that somebody types. Raises `UsageError` where there will be none any more."""
    from schemas.errors import UsageError

    try:
        return input(text)
    except EOFError:
        print()
        raise UsageError(
            "the answers ended before the questions: nothing is written",
            expected="a line for each question; an empty one takes what is offered, or leaves a key out",
        ) from None


def add_file(
    path: Path,
    arguments: Namespace,
    ask: Callable[[str], str] = _ask_person,
    shared: Mapping[Path, Collection[str]] = MappingProxyType({}),
) -> int:
    """Drafts, asks, checks and writes the mapping of one file; returns the exit status.

    `shared`: by file, the answers that are meant for others.
    """
    from ingest.answers import split_answers
    from ingest.mapping import own_mapping
    from schemas.errors import UsageError

    beside = own_mapping(path)
    if not path.is_file():
        raise UsageError("there is no such file", where=str(path), expected="a recording or a table")
    if beside.is_file() and beside.stat().st_size and not arguments.replace:
        raise UsageError(
            "it has a mapping already",
            where=beside.name,
            expected="a file without one",
            remedy=f"`dealab inspect {quote_path(str(path))}` says what it gives; --replace writes another",
        )
    given = split_answers(arguments.yes or [])
    given = {key: value for key, value in given.items() if key not in shared.get(path, ())}
    is_asked = arguments.yes is None
    draft, said = _ready(path, given, ask, is_asked=is_asked)
    if draft is None:
        for line in said:
            print(make_safe(line), file=sys.stderr)
        return FAILED
    for line in said:
        print(make_safe(line))
    if is_asked and sys.stdin.isatty():
        draft = _ask_wanted(draft, ask, arguments.rigs)
    return _write(draft, beside, arguments.rigs, is_asked=is_asked)


def _ready(
    path: Path, given: Mapping[str, str], ask: Callable[[str], str], *, is_asked: bool
) -> tuple[Draft | None, list[str]]:
    """The draft with every question answered and what was recognised; None and what is missing where one is not."""
    from ingest.answers import answered, as_suggested, draft_with
    from ingest.questions import list_lacks, name_column

    draft, placed = draft_with(path, given)
    draft = answered(draft, placed)
    lines = [f"{path.name}: {_recognised(draft)}"]
    lines += [f"  note       {text}" for text in draft.told]
    lines += [f"  column     {name_column(c)} is not mapped" for c in draft.unmapped]
    if is_asked and draft.questions and sys.stdin.isatty():
        print("\n".join(lines))
        return _ask_all(draft, ask), []
    if is_asked and draft.questions:
        wanted = shlex.join(f"{q.key}={_shown(q.suggestion)}" for q in draft.questions)
        lines += [f"  asks       {q.key}: {q.text}" for q in draft.questions]
        lines += [
            f"  lacks      {text}"
            for text in dict.fromkeys(lack.told for some in list_lacks(draft.content) for lack in some)
        ]
        return None, [*lines, f"Answer with: `dealab add {quote_path(str(draft.path))} --yes {wanted}`"]
    draft, taken = as_suggested(draft)
    if draft.questions:
        lines += [f"  asks       {q.key}: {q.text}; it cannot be guessed" for q in draft.questions]
        return None, [*lines, "Answer with --yes " + " ".join(f"{q.key}=…" for q in draft.questions)]
    lines += [f"  assumed    {q.key} = {_shown(q.suggestion)}: {q.text}" for q in taken if q.suggestion != []]
    return draft, lines


def _shown(suggestion: Any) -> str:
    """A suggestion as it can be typed after `--yes`."""
    from ingest.answers import write_value

    return "…" if suggestion is None else write_value(suggestion)


def _ask_all(draft: Draft, ask: Callable[[str], str]) -> Draft:
    """Asks each question until its answer can be used; an empty line takes the suggestion."""
    from ingest.answers import answered, read_value

    for question in draft.questions:
        offered = "" if question.suggestion in (None, []) else f" [{question.suggestion}]"
        among = f" ({', '.join(question.choices)})" if question.choices else ""
        while True:
            text = ask(f"  {question.text}{among}{offered}: ").strip()
            if not text and question.suggestion is None:
                continue
            if text and question.choices and text not in question.choices:
                continue
            break
        kept = _value_at(draft.content, question.key)
        is_text = isinstance(question.suggestion, str)
        draft = answered(draft, {question.key: (text if is_text else read_value(text)) if text else kept})
    return draft


def _ask_wanted(draft: Draft, ask: Callable[[str], str], rigs: Path | None) -> Draft:
    """Asks what this kind of test needs for all its results; an empty line leaves a key out."""
    from ingest.answers import answer_key, answered
    from ingest.questions import list_lacks
    from schemas.errors import RefusedError

    lacked = [[key for lack in lacks for key in lack.keys] for lacks in list_lacks(draft.content)]
    everywhere = [key for key in dict.fromkeys(chain(*lacked)) if all(key in keys for keys in lacked)]
    for key in everywhere:
        while text := ask(f"  {key}: {_describe(key, draft.path, rigs)} (Enter leaves it out): ").strip():
            try:
                draft = answered(draft, answer_key(key, text))
                break
            except RefusedError as error:
                print(make_safe(f"    {error}"))
    return draft


def _describe(key: str, path: Path, rigs: Path | None) -> str:
    """What a key means; of the rig, which files of rigs there are as well."""
    from ingest.rigs import list_rigs
    from schemas.metadata import describe_key

    there = list_rigs(path, rigs) if key == "rig_id" else []
    return make_safe(f"{describe_key(key)}; there is {', '.join(there)}" if there else describe_key(key))


def _tell_missing(draft: Draft, beside: Path, rigs: Path | None, *, is_asked: bool) -> list[str]:
    """What the mapping still lacks, as lines to put into it, and where; empty where it lacks nothing."""
    from ingest.answers import is_text
    from ingest.mapping_keys import RECORDING
    from ingest.questions import list_lacks

    lacks = list_lacks(draft.content)
    keys = list(dict.fromkeys(key for some in lacks for lack in some for key in lack.keys))
    if not keys:
        return []
    place = f"[{RECORDING}]" + (" (of one part: [select.recording])" if len(lacks) > 1 else "")
    again = "" if is_asked else f", or {keys[0]}=… and so on behind --yes, with --replace"
    typed = [f"{key} = " + ('"…"' if is_text(key) else "…") for key in keys]
    return [
        f"Still missing; write what you know of it below {place} in {make_safe(beside.name)}{again}:",
        *(f"  {line:<24} # {_describe(key, draft.path, rigs)}" for key, line in zip(keys, typed, strict=True)),
    ]


def _value_at(content: Mapping[str, Any], key: str) -> Any:
    value: Any = content
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _recognised(draft: Draft) -> str:
    if draft.shape is not None:
        about = draft.content["recording"]
        asked = f"{about['protocol']}, {about['loading']}"
        known = f"; its samples cannot be read yet: {draft.unread}" if draft.unread else ""
        shown = f"{draft.shape.protocol}, {draft.shape.loading}"
        if asked != shown:
            return f"{asked}, as you say; its samples show {shown} ({draft.shape.certainty}: {draft.shape.seen}){known}"
        return f"{asked} ({draft.shape.certainty}: {draft.shape.seen}){known}"
    return f"a table of kind {draft.content['kind']}"


def _write(draft: Draft, beside: Path, rigs: Path | None, *, is_asked: bool) -> int:
    """Checks the mapping with its file and writes it; where anything is wrong, says all of it and writes nothing."""
    from ingest.atomic import written_whole
    from ingest.compressed import find_stem, find_suffix
    from ingest.faults import find_faults
    from ingest.mapping import FileMapping
    from ingest.rigs import find_home
    from pipeline.commands.show.preview import describe_preview

    path = draft.path
    faults = find_faults(path, draft.content, source=beside.name, rigs=rigs)
    if faults:
        for fault in faults:
            print(f"  wrong      {make_safe(str(fault))}", file=sys.stderr)
        print(f"dealab: nothing is written: {len(faults)} things to put right (answers with --yes)", file=sys.stderr)
        return FAILED
    mapping = FileMapping.parse(draft.content, stem=find_stem(path), suffix=find_suffix(path), source=beside.name)
    lines = [make_safe(line) for line in describe_preview(path, mapping, rigs)]
    with written_whole(beside) as place:
        place.write_text(draft.as_toml(), encoding="utf-8")
    print("\n".join(lines))
    folder = make_safe(quote_path(str(find_home(path))))
    print(f"Written: {make_safe(str(beside))}. The next `dealab nightly {folder}` takes the file.")
    for line in _tell_missing(draft, beside, rigs, is_asked=is_asked):
        print(line)
    return ATTENTION if any(line.startswith("  problem") for line in lines) else DONE


COMMAND = Command(
    (
        "run7.csv",
        "run7.csv --yes specimen_id=P-07 force.unit=mN",
        "run*.csv --yes rig_id=rig-a",
        "exports/ --yes zone=Europe/Berlin",
    ),
    (argument("file", nargs="+", type=parse_path, metavar="FILE|FOLDER"), YES, REPLACE, RIGS),
    run,
)
