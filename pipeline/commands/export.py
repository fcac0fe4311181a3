"""`dealab export`: a film's model in the terms of a finite-element program, or all of a lab's results as a crate."""

from __future__ import annotations

import sys
from argparse import Namespace

from pipeline.commands.command import DONE, LAB, Command, argument, parse_path
from pipeline.lab.lab import Lab
from schemas.errors import UsageError

_MODULI = ("young", "shear")
_PROGRAMS = ("abaqus", "ansys", "comsol", "ls-dyna", "csv", "json")


def run(arguments: Namespace) -> int:
    from ingest.atomic import written_whole
    from pipeline.commands.series import read_series
    from pipeline.transform.prony import write_deck

    if arguments.crate is not None:
        return _export_crate(arguments)
    if arguments.about is not None:
        raise UsageError("--about says who made a crate", expected="--crate FILE with it")
    if arguments.specimen is None or arguments.program is None:
        raise UsageError("nothing is named", expected="a specimen and --as PROGRAM, or --crate FILE for all of a lab")
    series = read_series(Lab(arguments.lab), arguments.specimen, arguments.modulus)
    deck = write_deck(series, arguments.program)
    if arguments.out is None:
        sys.stdout.write(deck)
        return DONE
    with written_whole(arguments.out) as file:
        file.write_text(deck, encoding="utf-8")
    print(f"{arguments.specimen}: {len(series.times_s)} terms for {arguments.program} in {arguments.out}")
    return DONE


def _export_crate(arguments: Namespace) -> int:
    """Writes the crate of a lab, and says its digest and what the authors have still to state."""
    from pipeline.commands.crate.archive import ARCHIVES, discard, write_crate
    from pipeline.commands.crate.metadata import read_about

    for name, given in (("--as", arguments.program), ("--out", arguments.out), ("--modulus", arguments.modulus)):
        if given is not None:
            raise UsageError(
                f"{name} has no place beside --crate", expected="a crate of the whole lab, or a film alone"
            )
    target, about = arguments.crate, read_about(arguments.about)
    lab = Lab(arguments.specimen or arguments.lab)
    lab.require_database()
    lab.refuse_links()
    if target.exists():
        raise UsageError(f"{target} is there already", expected="a name that is free: no crate is written over")
    if target.suffix and target.suffix.lower() not in ARCHIVES:
        raise UsageError(f"{target}: no crate ends like this", expected="a folder, or a file that ends in .zip or .eln")
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.stem}.part{target.suffix}")
    discard(temporary)
    try:
        digests, digest = write_crate(lab, temporary, about, target.stem)
        temporary.replace(target)
    finally:
        discard(temporary)
    print(f"{target}: {len(digests)} files. SHA-256 of the results: {digest}")
    if about.missing:
        print(
            f"Not stated, and asked for by DataCite or RO-Crate: {', '.join(about.missing)}"
            " (--about FILE.toml states them)"
        )
    return DONE


COMMAND = Command(
    (
        "PA-1 --as abaqus --out pa1.inp",
        "PA-1 --as json",
        "rubber --as ansys --modulus shear",
        "--crate results.zip --about paper.toml",
    ),
    (
        argument("specimen", nargs="?", metavar="SPECIMEN", help="its specimen_id; with --crate a lab"),
        argument("--as", dest="program", choices=_PROGRAMS, help="program, or csv or json"),
        argument("--out", type=parse_path, metavar="FILE", help="file to write (default: standard output)"),
        argument("--modulus", choices=_MODULI, help="what the moduli of a file of a rheometer are"),
        argument("--crate", type=parse_path, metavar="FILE", help="an RO-Crate of all results: a folder, .zip or .eln"),
        argument("--about", type=parse_path, metavar="TOML", help="title, creators, publisher, license of the crate"),
        LAB,
    ),
    run,
)
