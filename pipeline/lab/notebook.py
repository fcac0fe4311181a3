"""The door for notebooks: a lab's results as pandas frames, and a specimen's model to be used again.

    from dealab import Lab
    lab = Lab("lab")
    lab.sql("SELECT * FROM best_models")        any read-only query
    lab.samples("PA-1-sphs-7kV")                raw samples over time in s
    lab.responses("PA-1")                       frequency responses of a specimen or a recording
    lab.table("step_responses", specimen_id=…)  any table, the rows that match
    lab.fit("PA-1").plot()                      the fitted model: parameters, evaluate, plot, simulate
    lab.figures("PA-1")                         the figures there are, and what each shows
    lab.figure("PA-1", "response")              one of them, as a matplotlib Figure

Frames carry the units of their columns in `frame.attrs["units"]`. Does not belong here: computing anything anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pipeline.lab.lab
from schemas.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    from matplotlib.figure import Figure

    from pipeline.lab.fitted import FittedModel
    from reports.gallery import Exhibit

_RESPONSE_UNITS = {
    "stiffness_n_per_mm": "N/mm",
    "force_per_voltage_squared_n_per_kv2": "N/kV²",
    "output_per_input": "output per input",
}

_BY_NOISE = "coalesce(weighting, '') NOT IN ('uniform', 'relative')"
"""Of the fits of an order those among which an order is chosen."""


class Lab(pipeline.lab.lab.Lab):
    """A lab folder and what stands in its published snapshot. Every call reads the snapshot that is published then."""

    __slots__ = ()

    def sql(self, query: str) -> pd.DataFrame:
        """Rows of a read-only query on the published snapshot, as a pandas frame."""
        from pipeline.lab.query import Query

        with Query(self) as database:
            frame: Any = database.run(query).to_pandas()
            return frame

    def samples(self, recording_id: str) -> pd.DataFrame:
        """Samples of a recording in canonical units, a column per channel, over `time_s` since its first sample.

        `attrs`: `units` by column, `recording_id`, `start_ns` (Unix time of the first sample). Raises `DealabError` for
        a recording without samples in the lab.
        """
        import pyarrow.parquet as pq

        literal = recording_id.replace("'", "''")
        found = self.sql(
            f"SELECT samples_path FROM recordings WHERE recording_id = '{literal}' AND status <> 'duplicate'"
        )
        path = (
            None if found.empty or not isinstance(found["samples_path"].iloc[0], str) else found["samples_path"].iloc[0]
        )
        if path is None or not (self.folder / path).is_file():
            raise UsageError(
                f'no samples of recording "{recording_id}" in this lab',
                remedy=self.spell_command('sql "SELECT recording_id, status FROM recordings"') + " lists them",
            )
        table = pq.read_table((self.folder / path).absolute())  # s3:x would be an address
        frame: Any = table.to_pandas()
        start = int(frame["time_ns"].iloc[0]) if len(frame) else 0
        frame.index = ((frame.pop("time_ns") - start) / 1e9).rename("time_s")
        units = {f.name: (f.metadata or {}).get(b"unit", b"").decode() for f in table.schema if f.name != "time_ns"}
        frame.attrs = {"units": units, "recording_id": recording_id, "start_ns": start}
        return frame

    def table(self, name: str, **where: str | float) -> pd.DataFrame:
        """Rows of a table (or view) whose columns have the given values, with the columns' units in `attrs`."""
        from schemas.tables import TABLES

        columns = TABLES[name].columns if name in TABLES else ()
        for word in (name, *where):
            if not word.isidentifier():
                raise UsageError(
                    f'"{word}" is no name', expected="a table and columns of it; `dealab schema` lists them"
                )
        match = " AND ".join(f'"{column}" = {_literal(value)}' for column, value in where.items())
        frame = self.sql(f"SELECT * FROM {name}{' WHERE ' + match if match else ''}")
        frame.attrs["units"] = {column.name: column.unit for column in columns if column.name in frame.columns}
        return frame

    def responses(self, item: str, *, stage: str | None = None) -> pd.DataFrame:
        """Frequency responses of a specimen or a recording, of one stage (`measured`, `corrected`, `averaged`) or all.

        The complex value stands in the column `value`. Raises `UsageError` where there is none.
        """
        rows = self.table("frequency_responses", specimen_id=item)
        if rows.empty:
            rows = self.table("frequency_responses", recording_id=item)
        if stage is not None:
            rows = rows[rows["stage"] == stage]
        if rows.empty:
            raise UsageError(
                f'no frequency response of "{item}"', expected="a specimen_id or a recording_id that has one"
            )
        frame = rows.sort_values(["loading", "stage", "recording_id", "frequency_hz"], ignore_index=True)
        frame.insert(list(frame.columns).index("real"), "value", frame["real"] + 1j * frame["imag"])
        unit = " or ".join(_RESPONSE_UNITS.get(q, q) for q in dict.fromkeys(frame["quantity"]))
        units = dict(rows.attrs["units"])
        units |= dict.fromkeys(("value", "real", "imag", "magnitude", "standard_error", "between_spread"), unit)
        frame.attrs = {"units": units, "item": item}
        return frame

    def fit(self, specimen_id: str, *, order: int | None = None, extended: bool = False) -> FittedModel:
        """The model of a specimen: the fit to use, the same of another order, or the one that a diagnosis has extended.

        Raises `UsageError` where the specimen has no such fit.
        """
        import json

        from pipeline.lab.fitted import FittedModel

        if extended and order is not None:
            raise UsageError("an extended model of another order", expected="extended, or an order")
        of_order = "selected" if order is None else f"model_order = {int(order)} AND {_BY_NOISE}"
        wanted = "coalesce(extension, '') <> ''" if extended else f"{of_order} AND coalesce(extension, '') = ''"
        rows = self._rows(
            f"SELECT * FROM model_fits WHERE specimen_id = {_literal(specimen_id)} AND {wanted} "
            "ORDER BY CASE loading WHEN 'mechanical' THEN 0 WHEN 'joint' THEN 1 ELSE 2 END, "
            "CASE method WHEN 'forward' THEN 0 WHEN 'corrected' THEN 1 ELSE 2 END, selected DESC LIMIT 1"
        )
        if not rows:
            kind = "extended model" if extended else "fitted model" if order is None else f"model of order {order}"
            raise UsageError(
                f'no {kind} of specimen "{specimen_id}"',
                remedy=self.spell_command('sql "SELECT specimen_id, extension FROM model_fits WHERE selected"')
                + " lists them",
            )
        about = self._rows(
            f"SELECT metadata, loading FROM recordings WHERE specimen_id = {_literal(specimen_id)} "
            "AND status IN ('ok', 'damaged') AND metadata IS NOT NULL ORDER BY loading = 'mechanical', started_at"
        )
        severity = self._rows(f"SELECT severity FROM diagnoses WHERE specimen_id = {_literal(specimen_id)}")
        force = self._rows(
            "SELECT force_per_voltage_squared_n_per_kv2 AS force FROM model_fits WHERE specimen_id = "
            f"{_literal(specimen_id)} AND selected AND force_per_voltage_squared_n_per_kv2 IS NOT NULL "
            "ORDER BY loading <> 'electrical', method, extension LIMIT 1"
        )
        stored = [json.loads(row["metadata"]) for row in about]
        return FittedModel(
            specimen_id=specimen_id,
            row=rows[0],
            geometry={k: v for one in stored for k, v in dict(one.get("recording", {})).items()},
            rig={k: v for one in stored for k, v in dict(one.get("rig", {})).items()},
            force_per_voltage_squared=float(force[0]["force"]) if force else None,
            effects=_choose_effects(rows[0], json.loads(severity[0]["severity"] or "{}") if severity else {}),
            measured=self.table("frequency_responses", specimen_id=specimen_id),
        )

    def figures(self, thing: str) -> pd.DataFrame:
        """The figures of a specimen, a recording, a campaign or `lab`: `name`, `about`, `finding`, a row each."""
        import pandas as pd

        rows = [(e.name, e.about, e.finding) for e in self._find_exhibits(thing)]
        return pd.DataFrame(rows, columns=["name", "about", "finding"])

    def figure(self, thing: str, kind: str, *, width: str | None = None) -> Figure:
        """A figure of the pages, drawn by matplotlib for print: `lab.figure("PA-1", "response").savefig("pa1.pdf")`.

        `width` is `single` (85 mm) or `double` (175 mm), by default what suits the kind. `get_label()` of the figure is
        its finding. Raises `UsageError` where there is no such figure; `figures` lists them.
        """
        from reports.figures.paper import WIDTHS_MM
        from reports.gallery import choose_exhibit

        if width is not None and width not in WIDTHS_MM:
            raise UsageError(f'"{width}" is no width', expected=" or ".join(WIDTHS_MM))
        figure: Figure = choose_exhibit(self._find_exhibits(thing), thing, kind).picture.draw(width).figure
        _show_in_notebooks()
        return figure

    def _find_exhibits(self, thing: str) -> list[Exhibit]:
        from reports.gallery import find_exhibits
        from reports.results import Results
        from reports.site import Site

        self.require_database()
        with Results(self.folder) as results:
            return find_exhibits(Site(results), thing)

    def _rows(self, query: str) -> list[dict[str, Any]]:
        """Rows with NULL as None, which a frame would make NaN."""
        from pipeline.lab.query import Query

        with Query(self) as database:
            rows: list[dict[str, Any]] = database.run(query).to_pylist()
        return rows


def _choose_effects(row: Mapping[str, Any], severities: Mapping[str, Any]) -> dict[str, Any]:
    """What was found of the mechanisms in a fit; faults of recordings are in no model."""
    return {name: severities[name] for name in (row["extension"] or "").split(",") if name in severities}


def _show_in_notebooks() -> None:
    """Lets a notebook draw figures that pyplot has not made, as it does once a figure of pyplot has been shown."""
    import sys

    if "IPython" in sys.modules:
        import matplotlib.pyplot as plt

        plt.install_repl_displayhook()


def _literal(value: str | float) -> str:
    return "'" + value.replace("'", "''") + "'" if isinstance(value, str) else repr(float(value))
