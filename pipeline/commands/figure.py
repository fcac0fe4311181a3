"""`dealab figure`: a figure of the pages for a paper or a thesis, as PDF, SVG or PNG, with its data."""

from __future__ import annotations

from argparse import Namespace
from typing import TYPE_CHECKING

from pipeline.commands.command import DONE, LAB, Command, argument, parse_path
from pipeline.lab.lab import Lab
from schemas.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from reports.gallery import Exhibit

_ALL = "all"
_ENDINGS = (".pdf", ".svg", ".png")


def run(arguments: Namespace) -> int:
    from reports.gallery import choose_exhibit, find_exhibits
    from reports.results import Results
    from reports.site import Site
    from schemas.visible import make_safe

    lab, thing = Lab(arguments.lab), arguments.thing
    lab.require_database()
    with Results(lab.folder) as results:
        exhibits = find_exhibits(Site(results), thing)
    if arguments.kind is None:
        if arguments.out is not None or arguments.data:
            raise UsageError("no figure is named", expected=f"one of {_list_names(exhibits)}, or {_ALL}")
        for line in describe_exhibits(exhibits, thing):
            print(make_safe(line))
        return DONE
    if arguments.out is None:
        folder = " or a folder" if arguments.kind == _ALL else ""
        raise UsageError("--out is missing", expected=f"a file that ends in {', '.join(_ENDINGS)}{folder}")
    if arguments.kind == _ALL:
        if arguments.out.suffix in _ENDINGS or arguments.out.is_file():
            raise UsageError(f"--out {arguments.out} is a file", expected=f"a folder, for {_ALL} figures")
        arguments.out.mkdir(parents=True, exist_ok=True)
        chosen = [(e, arguments.out / f"{e.name}.pdf") for e in exhibits]
    else:
        chosen = [(choose_exhibit(exhibits, thing, arguments.kind), arguments.out)]
    for exhibit, out in chosen:
        for line in write_exhibit(exhibit, thing, out, width=arguments.width, data=arguments.data):
            print(make_safe(line))
    return DONE


def describe_exhibits(exhibits: Sequence[Exhibit], thing: str) -> list[str]:
    """A line for each figure: its name, what it shows, and its finding."""
    if not exhibits:
        return [f"{thing} has no figure."]
    wide = max(len(e.name) for e in exhibits)
    return [f"{e.name:<{wide}}  {e.finding}" for e in exhibits]


def write_exhibit(
    exhibit: Exhibit, thing: str, out: Path, *, width: str | None = None, data: bool = False
) -> list[str]:
    """Writes a figure, and its data beside it where asked for; gives a line for each file.

    Raises `UsageError` where the ending says no format.
    """
    from ingest.atomic import written_whole
    from reports.figures.paper import ENDINGS, write_figure

    form = ENDINGS.get(out.suffix.lower())
    if form is None:
        raise UsageError(f"{out}: a figure has no such format", expected=f"a file that ends in {', '.join(ENDINGS)}")
    figure = exhibit.picture.draw(width)
    with written_whole(out) as file:
        write_figure(figure, file, form, title=f"{thing}: {exhibit.about}", finding=exhibit.finding)
    lines = [f"{out}: {exhibit.finding}"]
    if not data:
        return lines
    for number, (name, text) in enumerate(exhibit.files.items()):
        beside = out.with_suffix(".csv") if number == 0 else out.with_name(f"{out.stem}_{name}")
        with written_whole(beside) as file:
            file.write_text(text, encoding="utf-8")
        lines.append(f"{beside}: its data")
    return lines


def _list_names(exhibits: Sequence[Exhibit]) -> str:
    return ", ".join(e.name for e in exhibits) or "none: there is no figure"


COMMAND = Command(
    (
        "PA-3",
        "PA-3 response --out pa3.pdf",
        "PA-3 force-map --out map.svg --width double --data",
        f"PA-3 {_ALL} --out figures",
    ),
    (
        argument("thing", metavar="ID", help="a specimen, a recording, a campaign, or lab"),
        argument("kind", nargs="?", metavar="KIND", help=f"which figure, or {_ALL} (default: says which there are)"),
        argument("--out", type=parse_path, metavar="FILE", help=f"ends in .pdf, .svg or .png; a folder for {_ALL}"),
        argument("--width", choices=("single", "double"), help="85 or 175 mm (default: what suits the figure)"),
        argument("--data", action="store_true", help="write the data beside it, as CSV"),
        LAB,
    ),
    run,
)
