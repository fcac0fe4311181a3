"""The part of a specimen's page about orders under voltage: force over V² against the models of each order, and their errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from reports.blocks import Figure, Head, Pair, Row, Section, Table, bold, flow
from reports.figures.electrical import Ordered, orders
from reports.figures.responses import Lines
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import ABSENT, NBSP, compact, percent, significant

_SQL = """SELECT form, model_order, voltage_kv, recording_id, magnitude_error_n_per_kv2, relative_error, phase_error_deg, frequency_lines
FROM voltage_orders
WHERE specimen_id = $specimen
ORDER BY model_order, form, voltage_kv, recording_id"""
_CURVES_SQL = """SELECT recording_id, voltage_kv, form, model_order, frequency_hz, "real", imag, standard_error, usable
FROM voltage_curves
WHERE specimen_id = $specimen AND form = 'without_resonance'
ORDER BY voltage_kv, recording_id, model_order NULLS FIRST, frequency_hz"""
_CHOSEN_SQL = """SELECT model_order
FROM model_fits
WHERE specimen_id = $specimen AND loading = 'electrical' AND selected AND coalesce(extension, '') = ''"""
_MOST = 6
"""Recordings drawn at most; the rest stand in the data file."""


def section(draft: Draft) -> Section | None:
    """F/V² freed of the clamp's resonance with the models of each order, and the table of their errors."""
    query = Query(_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    chosen = next((r["model_order"] for r in draft.results.rows(Query(_CHOSEN_SQL, {"specimen": draft.item}))), None)
    data = draft.results.columns(Query(_CURVES_SQL, {"specimen": draft.item}))
    drawn = _ordered(data)[:_MOST]
    href = draft.data("voltage-orders", data)
    who = short(draft.item, 40)
    words = _words(found)
    images = (
        orders(drawn, chosen, phase=False, title="F/V² without the clamp's resonance, mN/kV²", alt=f"Force over V² of {who}. {words}"),
        orders(drawn, chosen, phase=True, title="Its phase, degrees", alt=f"Phase of the force over V² of {who}. {words}"),
    )  # fmt: skip
    pair = Pair(
        (
            Figure(
                images[0],
                flow(bold("Orders under voltage."), f" {words} Lines: models whose springs and dampers are those of the mechanical tests."),
                href,
            ),
            Figure(
                images[1],
                "At fixed length the film's relaxation shows only through the load cell that gives way: this curve depends on the"
                " load cell's stiffness, the blocked force above does not.",
                href,
            ),
        )
    )  # fmt: skip
    return Section(
        "voltage-orders", _heading(found, chosen), "Orders under voltage", (pair, _table(query, found, chosen))
    )


def _ordered(data: Mapping[str, Any]) -> list[Ordered]:
    recordings = [str(r) for r in data["recording_id"]]
    made = []
    for name in dict.fromkeys(recordings):
        mine = np.array([r == name for r in recordings])
        order = np.array([-1 if o is None or o != o else int(o) for o in data["model_order"]])
        value = data["real"].astype(float) + 1j * data["imag"].astype(float)
        rows = mine & (order == -1)
        lines = Lines(
            data["frequency_hz"][rows].astype(float), value[rows], data["standard_error"][rows].astype(float),
            data["usable"][rows].astype(bool), np.ones(int(rows.sum())),
        )  # fmt: skip
        models = {int(o): value[mine & (order == o)] for o in np.unique(order[mine]) if o > 0}
        volts = data["voltage_kv"][rows][0]
        made.append(
            Ordered(
                short(name, 16) if volts is None or volts != volts else f"{compact(float(volts), 2)} kV", lines, models
            )
        )
    return made


def _mean(found: Sequence[Record], form: str, order: int, what: str) -> float:
    values = [r[what] for r in found if r["form"] == form and r["model_order"] == order]
    return float(np.mean(values)) if values else float("nan")


def _words(found: Sequence[Record]) -> str:
    every = sorted({r["model_order"] for r in found})
    parts = [
        f"order {o} {percent(_mean(found, 'without_resonance', o, 'relative_error'))}"
        f" (as recorded {percent(_mean(found, 'recorded', o, 'relative_error'))})"
        for o in every
    ]
    return f"Relative error over all voltages with the resonance taken out of the record: {', '.join(parts)}."


def _heading(found: Sequence[Record], chosen: int | None) -> str:
    every = sorted({r["model_order"] for r in found})
    order = every[-1] if chosen is None or chosen not in every else chosen
    kept = percent(_mean(found, "recorded", order, "relative_error"))
    ignored = percent(_mean(found, "resonance_ignored", order, "relative_error"))
    return f"Under voltage order {order} errs by {kept} of the force as recorded; without the clamp's resonance in the model it would by {ignored}"


def _table(query: Query, found: Sequence[Record], chosen: int | None) -> Table:
    """Errors per order and voltage, with the resonance in the model, taken out, and ignored."""
    rows = []
    keys = dict.fromkeys((r["model_order"], r["voltage_kv"], r["recording_id"]) for r in found)
    for order, volts, recording in keys:
        mine = {r["form"]: r for r in found if (r["model_order"], r["recording_id"]) == (order, recording)}
        cells = []
        for form in ("recorded", "without_resonance", "resonance_ignored"):
            r = mine.get(form)
            cells += (
                [ABSENT] * 2
                if r is None
                else [significant(1e3 * r["magnitude_error_n_per_kv2"], 2), significant(r["phase_error_deg"], 2)]
            )
        rows.append(
            Row(
                (
                    f"{order}{' ✓' if order == chosen else ''}",
                    short(recording, 24) if volts is None else compact(volts, 2),
                    *cells,
                    str(next(iter(mine.values()))["frequency_lines"]),
                ),
                "sel" if order == chosen else "",
            )
        )
    heads = (
        Head("Order"), Head("Voltage, kV", "n"), Head("As recorded, mN/kV²", "n"), Head("phase, °", "n"),
        Head("Resonance taken out, mN/kV²", "n"), Head("phase, °", "n"), Head("Resonance ignored, mN/kV²", "n"), Head("phase, °", "n"),
        Head("Lines", "n"),
    )  # fmt: skip
    below = (
        "Mean absolute errors of magnitude and phase (thesis, eq 4.14) over the usable lines. As recorded: clamp and load cell in the"
        f" model. Taken out: their inertia taken out of the record, which near the resonance magnifies its noise. Ignored: a{NBSP}model"
        " of the film on a load cell without clamp, against the record."
    )
    return Table("Errors of each order under voltage", heads, tuple(rows), query.shown(), below=below, kind="wide")
