"""The part of a specimen's page about clamp and load cell: what their resonance takes from the record.

A response that came as a table has none of them in it; there it is what the machine's own compliance took.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from reports.blocks import Figure, Pair, Section, bold, code, flow
from reports.evidence import Measured, drawable
from reports.figures import responses as figures
from reports.figures.curves import Rig, stiffness
from reports.figures.machine import compliance
from reports.figures.responses import Lines
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Row as Record
from schemas.numbers import NBSP, compact, counted, significant


def section(
    draft: Draft, chosen: Record | None, found: Measured, constants: Rig | None, damaged: Set[str]
) -> Section | None:
    """What the resonance of clamp and load cell took from the record, and where nothing is left to correct."""
    pairs = found.stage("corrected")
    recordings = [r for r, lines in pairs.items() if lines.size > 2 and ("measured", r) in found.by_recording]
    if not recordings:
        return None
    recording = max(recordings, key=lambda r: (r not in damaged, pairs[r].size))
    lines, recorded = pairs[recording], found.by_recording["measured", recording]
    if constants is None:
        return _machine(draft, recording, lines)
    low, high = float(lines.frequency.min()), float(lines.frequency.max())
    grid = np.geomspace(low, high, 200)
    expected = None
    if constants is not None and chosen is not None and drawable(chosen):
        k = stiffness(chosen, grid)
        expected = constants.recorded(k, grid) / k
    stretches = figures.beyond(lines.frequency, lines.amplification)
    lost = " and ".join(f"{compact(a, 2)} to {compact(b, 2)}{NBSP}Hz" for a, b in stretches)
    most = float(np.nanmax(lines.amplification, initial=0.0))
    href = draft.data(
        "correction",
        {
            "frequency_hz": lines.frequency,
            "recorded_real": np.interp(lines.frequency, recorded.frequency, recorded.value.real),
            "recorded_imag": np.interp(lines.frequency, recorded.frequency, recorded.value.imag),
            "corrected_real": lines.value.real,
            "corrected_imag": lines.value.imag,
            "amplification": lines.amplification,
        },
    )
    where = f"unusable from {lost}" if lost else "usable everywhere"
    left = Figure(
        figures.correction(
            lines, recorded, expected, grid,
            alt=f"Recorded over corrected stiffness of {short(recording, 40)} from {low:.3g} to {high:.3g} Hz; {where}.",
        ),
        flow(bold("Clamp and load cell."), " Points: recorded over corrected response of ", code(short(recording, 60)), "; line: the fitted rig alone."),
        href,
    )  # fmt: skip
    right = Figure(
        figures.amplification(
            lines, alt=f"The correction amplifies the relative noise by up to {significant(most, 2)}; {where}."
        ),
        flow(bold("Cost of the correction."), f" Up to {significant(most, 2)} times the relative noise; beyond 5 a point is not used."),
        href,
    )  # fmt: skip
    resonance = constants.resonance_hz if constants else float("inf")
    if low < resonance < high:
        heading = f"Clamp and load cell resonate at {significant(resonance, 2)}{NBSP}Hz"
        heading += f"; from {lost} the record says nothing about the film" if lost else ""
    elif lost:
        heading = f"The correction carries no information from {lost}"
    else:
        heading = "The correction is safe at every frequency"
    return Section("correction", heading, "Correction", (Pair((left, right)),))


def _machine(draft: Draft, recording: str, lines: Lines) -> Section | None:
    """What a machine's own compliance took, where its table says how much it was."""
    known = np.isfinite(lines.amplification)
    if not known.any():
        return None
    most = float(lines.amplification[known].max())
    lost = int((~lines.usable[known]).sum())
    href = draft.data(
        "machine",
        {"frequency_hz": lines.frequency, "amplification": lines.amplification, "usable": lines.usable},
    )
    figure = Figure(
        compliance(
            lines,
            alt=f"The machine's own correction amplifies relative errors by up to {significant(most, 2)}; {lost} lines are not used.",
        ),
        flow(
            bold("The machine in series with the specimen."),
            f" Taking its own deformation off amplifies relative errors by up to {significant(most, 2)}, and its phase error"
            " becomes loss of the specimen. A line at which the machine deforms more than the specimen is not used.",
        ),
        href,
    )
    heading = "The machine deforms far less than the specimen"
    if lost:
        low, high = (float(v) for v in (lines.frequency[~lines.usable].min(), lines.frequency[~lines.usable].max()))
        heading = (
            f"The machine hides the specimen at {counted(lost, 'line')} from {compact(low)} to {compact(high)}{NBSP}Hz"
        )
    elif most > 1.2:
        heading = f"The machine's own deformation amplifies errors up to {significant(most, 2)} times"
    return Section("correction", heading, "Machine", (figure,))
