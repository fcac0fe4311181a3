"""`dealab verify`: whether a crate is what it says, and whether a lab or its recordings give the same again."""

from __future__ import annotations

from argparse import Namespace
from typing import TYPE_CHECKING

from pipeline.commands.command import DONE, FAILED, RIGS, Command, argument, parse_path
from pipeline.lab.lab import Lab
from schemas.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_SHOWN = 60
"""Lines about what differs that are printed; the others are counted."""


def run(arguments: Namespace) -> int:
    from pipeline.commands.crate.archive import compare_digests, digest_results, read_crate
    from schemas.visible import make_safe

    if arguments.raw and arguments.lab is not None:
        raise UsageError("--lab and --raw are two ways to the same", expected="one of them")
    files = read_crate(arguments.crate)
    wrong = compare_digests(files)
    _say(f"{arguments.crate}: {len(files)} files", wrong, "every SHA-256 is as listed")
    if not wrong:
        print(f"SHA-256 of the results: {digest_results(_hash_all(files))}")
    wrong += _check_metadata(files)
    if arguments.raw:
        wrong += _verify_raw(files, arguments.raw, arguments.rigs)
    elif arguments.lab is not None:
        wrong += _verify_lab(files, Lab(arguments.lab), str(arguments.lab))
    else:
        print("Results were not made again: --lab LAB compares a lab's, --raw RAW runs a night over recordings.")
    for line in wrong[:_SHOWN]:
        print(make_safe(line))
    if len(wrong) > _SHOWN:
        print(f"and {len(wrong) - _SHOWN} more")
    return FAILED if wrong else DONE


def _hash_all(files: Mapping[str, bytes]) -> dict[str, str]:
    import hashlib

    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}


def _say(what: str, wrong: list[str], well: str) -> None:
    print(f"{what}: {well if not wrong else f'{len(wrong)} differ'}.")


def _check_metadata(files: Mapping[str, bytes]) -> list[str]:
    """The files and hashes that the metadata name are those of the manifest."""
    import json

    from pipeline.commands.crate.metadata import METADATA

    digests = _hash_all(files)
    try:
        graph = json.loads(files[METADATA])["@graph"]
        named = {e["@id"]: e.get("sha256") for e in graph if e.get("@type") == "File"}
    except (ValueError, KeyError, TypeError, AttributeError):
        return [f"{METADATA}: no JSON-LD of a crate"]
    lines = [f"{METADATA}: {n} is named and not there" for n in sorted(set(named) - set(files))]
    lines += [f"{METADATA}: {n} has another SHA-256" for n in sorted(set(named) & set(files)) if named[n] != digests[n]]
    return lines + [f"{METADATA}: {n} is not named" for n in sorted(set(files) - set(named) - {METADATA})]


def _verify_lab(files: Mapping[str, bytes], lab: Lab, name: str) -> list[str]:
    """The results of a lab, made again by the code that stands here, against those of the crate."""
    from pipeline.commands.crate.compared import compare_results
    from pipeline.commands.crate.contents import write_results

    lab.require_database()
    wrong = compare_results(files, dict(write_results(lab)))
    _say(f"Results of {name}", wrong, "all tables, models and figures are the same")
    return wrong


def _verify_raw(files: Mapping[str, bytes], raw: list[str], rigs: Path | None) -> list[str]:
    """A night over the recordings in a lab of its own, which goes again, and its results against those of the crate."""
    import tempfile

    from pipeline.commands.command import count_processors
    from pipeline.nightly.night import nightly

    with tempfile.TemporaryDirectory(prefix="dealab-verify-") as folder:
        lab = Lab(f"{folder}/lab")
        nightly(raw, lab, jobs=count_processors(), rigs=rigs)
        return _verify_lab(files, lab, "a night over the recordings")


COMMAND = Command(
    ("results.zip", "results.zip --lab lab", "results.zip --raw /data/rig-a"),
    (
        argument("crate", type=parse_path, metavar="CRATE", help="a folder, .zip or .eln"),
        argument("--lab", type=parse_path, metavar="LAB", help="compare with the results of this lab"),
        argument("--raw", nargs="+", metavar="RAW", help="run a night over these recordings and compare"),
        RIGS,
    ),
    run,
)
