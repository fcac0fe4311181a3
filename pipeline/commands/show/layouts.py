"""Electrode layouts in words, as a drawing to scale and as a table of corners."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.commands.show.rows import in_plain
from pipeline.lab.lab import Lab
from pipeline.lab.reader import Reader
from schemas.errors import UsageError
from schemas.numbers import bounds, compact, percent, significant

_CORNERS = ("x_low_mm", "x_high_mm", "y_low_mm", "y_high_mm")
_MARGIN_MM = 1.0


def show_layout(lab: Lab, configuration: str, design: str, out: Path | None) -> str:
    """What a night found for the electrodes of a configuration; writes the outlines where a file is named.

    Parameters
    ----------
    lab : whose database is read
    configuration, design : which electrodes
    out : an SVG; the CSV has its name with another ending

    Raises
    ------
    UsageError, LabError
        No electrodes were designed for that configuration, `out` is no SVG, or there is no database.
    """
    if out is not None and out.suffix != ".svg":
        raise UsageError(f"--out {out}", expected="a file that ends in .svg; the corners go into a .csv beside it")
    lab.require_database()
    with Reader(lab.database) as reader:
        designs = reader.rows("electrode_designs", None, "configuration", [configuration])
        shapes = reader.rows("electrode_shapes", None, "configuration", [configuration])
    found = next((r for r in designs if r["design"] == design), None)
    if found is None:
        raise UsageError(
            f'no {design} electrodes were designed for "{configuration[:80]}"',
            expected="a configuration over rods, in a campaign with lives of two electrode layouts",
            remedy=lab.spell_command('sql "SELECT DISTINCT configuration FROM electrode_designs"') + " lists them",
        )
    own = [r for r in shapes if r["design"] == design and r["campaign"] == found["campaign"]]
    bound = next((r for r in designs if r["design"] == "any shape" and r["campaign"] == found["campaign"]), found)
    said = [
        f"{configuration}: {design} electrodes cover {percent(found['covered_share'])} of the film",
        f"  life at the same force × {_life(found)}; no electrodes of any shape exceed × {_life(bound)} (90 %)",
        f"  force at the same voltage × {significant(found['relative_force'])}, voltage at the same force ×"
        f" {significant(found['voltage_ratio'])}; thinnest film {significant(found['thinnest'])} of the median",
    ]
    if found["gap_mm"] is not None:
        said.append(
            f"  {compact(found['gap_mm'])} mm from the rods' axes, {compact(found['inset_mm'])} mm from the film's ends"
        )
    if out is not None:
        table = out.with_suffix(".csv")
        out.write_text(draw_layout(own), encoding="utf-8")
        lines = [",".join(("number", *_CORNERS)), *(",".join(f"{r[n]:g}" for n in ("number", *_CORNERS)) for r in own)]
        table.write_text("\n".join(lines) + "\n", encoding="utf-8")
        said.append(f"  {len(own)} rectangles: {out}, {table}")
    return in_plain("\n".join(said))


def draw_layout(shapes: Sequence[dict[str, Any]]) -> str:
    """An SVG in mm, one rectangle each, y upwards as on the film; for a cutter or a drawing program.

    Parameters
    ----------
    shapes : rows of `electrode_shapes`
    """
    low_x, high_x = min(r["x_low_mm"] for r in shapes), max(r["x_high_mm"] for r in shapes)
    low_y, high_y = min(r["y_low_mm"] for r in shapes), max(r["y_high_mm"] for r in shapes)
    width, height = high_x - low_x + 2 * _MARGIN_MM, high_y - low_y + 2 * _MARGIN_MM
    drawn = "\n".join(
        f'<rect x="{r["x_low_mm"] - low_x + _MARGIN_MM:.4g}" y="{high_y - r["y_high_mm"] + _MARGIN_MM:.4g}"'
        f' width="{r["x_high_mm"] - r["x_low_mm"]:.4g}" height="{r["y_high_mm"] - r["y_low_mm"]:.4g}"/>'
        for r in shapes
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4g}mm" height="{height:.4g}mm"'
        f' viewBox="0 0 {width:.4g} {height:.4g}">\n<title>Electrodes, mm</title>\n'
        f'<g fill="#1b1f23">\n{drawn}\n</g>\n</svg>\n'
    )


def _life(row: dict[str, Any]) -> str:
    return bounds(row["life_ratio"], row["life_ratio_lower"], row["life_ratio_upper"])
