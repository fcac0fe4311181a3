"""A specimen's fitted model taken from the database to be used again: evaluated, plotted, put on the virtual rig."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pipeline.lab.extension import translate_severities
from pipeline.physics.film import RelaxationModel
from pipeline.simulate.specimen import GEOMETRY, Deviations, Material, Specimen, checked_geometry
from reports.figures.curves import arms, band
from schemas.arrays import Complex, Float
from schemas.errors import UsageError
from schemas.quantities import QUANTITIES
from schemas.tables import ARMS

if TYPE_CHECKING:
    import pandas as pd


_RIG = "rig"
_NORMAL_95 = 1.959964
_RIG_UNITS = {
    "clamp_mass_kg": "kg",
    "load_cell_stiffness_n_per_mm": "N/mm",
    "load_cell_damping_n_s_per_mm": "N s/mm",
    "force_per_voltage_squared_n_per_kv2": "N/kV²",
}


@dataclass(frozen=True)
class FittedModel:
    """The model of a specimen as the database holds it.

    Parameters
    ----------
    specimen_id : the specimen
    row : its row of `model_fits`
    geometry, rig : keys of its recordings and of their rig
    force_per_voltage_squared : N/kV², blocked force of its electrodes; None where no voltage was on it
    effects : mechanism → parameter → {value, sd}: what a diagnosis found, for the extended model
    measured : its rows of `frequency_responses`
    """

    specimen_id: str
    row: Mapping[str, Any] = field(repr=False)
    geometry: Mapping[str, Any] = field(repr=False)
    rig: Mapping[str, Any] = field(repr=False)
    force_per_voltage_squared: float | None = None
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    measured: pd.DataFrame | None = field(default=None, repr=False, compare=False)

    @property
    def model(self) -> RelaxationModel:
        """Springs in N/mm and relaxation times in s."""
        found = arms(self.row)
        springs = [(a.k, a.c / a.k) for a in found if a.k is not None]
        rigid = sum(a.c for a in found if a.k is None)
        k0 = float(self.row["k0_n_per_mm"] or 0.0)
        return RelaxationModel(k0, tuple(k for k, _ in springs), tuple(t for _, t in springs), rigid)

    def stiffness(self, frequency_hz: ArrayLike) -> Complex:
        """Complex dynamic stiffness of the film in N/mm at frequencies in Hz; shape of the input."""
        return self.model.stiffness(frequency_hz)

    def relaxation(self, time_s: ArrayLike) -> Float:
        """Relaxation function in N/mm at times in s after a step. A pure dashpot has none (`ValueError`)."""
        return self.model.relaxation(time_s)

    def parameters(self) -> pd.DataFrame:
        """Springs, dampers, relaxation times and fitted rig constants, a row each: value, 95 % limits, unit.

        Limits are those of the fit; where it keeps none, as an extended model, 1.96 standard deviations to either side.
        No number where a parameter is not resolved on that side.
        """
        import pandas as pd

        stored = json.loads(self.row.get("intervals") or "{}")
        rows = [
            (name, value, *_find_limits(stored.get(name), value, self.row.get(f"{column}_sd")), unit)
            for name, column, value, unit in self._list_parameters()
        ]
        frame = pd.DataFrame(rows, columns=["parameter", "value", "lower_95", "upper_95", "unit"])
        return frame.astype(dict.fromkeys(("value", "lower_95", "upper_95"), float)).set_index("parameter")

    def _list_parameters(self) -> Iterator[tuple[str, str, float, str]]:
        """Name, column in `model_fits` (none for relaxation times), value and unit of what the fit has."""
        for i in range(ARMS + 1):
            for name, column, unit in ((f"k{i}", f"k{i}_n_per_mm", "N/mm"), (f"c{i}", f"c{i}_n_s_per_mm", "N s/mm")):
                if self.row.get(column) is not None:
                    yield name, column, self.row[column], unit
            if i and self.row.get(f"k{i}_n_per_mm"):
                yield f"tau{i}", "", self.row[f"c{i}_n_s_per_mm"] / self.row[f"k{i}_n_per_mm"], "s"
        for name, unit in _RIG_UNITS.items():
            if self.row.get(name) is not None:
                yield name, name, self.row[name], unit

    def frame(self, frequency_hz: ArrayLike) -> pd.DataFrame:
        """The model at n frequencies: complex value, magnitude and phase with their standard deviations.

        `attrs["units"]` has the units of the columns.
        """
        import pandas as pd

        f = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
        value, spread = self.stiffness(f), band(self.row, f)
        spread = np.full((2, f.size), np.nan) if spread is None else spread
        frame = pd.DataFrame(
            {
                "frequency_hz": f, "value": value, "magnitude": np.abs(value), "magnitude_sd": spread[0],
                "phase_deg": np.degrees(np.angle(value)), "phase_deg_sd": np.degrees(spread[1]),
            }
        )  # fmt: skip
        units = dict.fromkeys(("value", "magnitude", "magnitude_sd"), "N/mm")
        frame.attrs = {"units": units | {"frequency_hz": "Hz", "phase_deg": "deg", "phase_deg_sd": "deg"}}
        return frame

    def plot(self, axes: Any = None) -> Any:
        """Draws measured |k| with its standard error and the model with its 95 % band; returns the matplotlib axes."""
        import matplotlib.pyplot as plt
        from matplotlib.ticker import LogLocator, NullFormatter

        axes = plt.figure(figsize=(5, 3.6), layout="constrained").gca() if axes is None else axes
        points = self._choose_points()
        low, high = self.row["frequency_low_hz"] or 0.1, self.row["frequency_high_hz"] or 100.0
        model = self.frame(np.geomspace(low, high, 200))
        if points is not None:
            axes.errorbar(
                points["frequency_hz"], points["magnitude"], 2 * points["standard_error"] / np.sqrt(2), fmt="o",
                markersize=3, color="#1b1f23", linewidth=0.8,
            )  # fmt: skip
        axes.plot(model["frequency_hz"], model["magnitude"], color="#0069a8", linewidth=1.6)
        wide = 1.96 * model["magnitude_sd"]
        axes.fill_between(
            model["frequency_hz"], model["magnitude"] - wide, model["magnitude"] + wide, color="#0069a8", alpha=0.2
        )
        axes.set(xscale="log", yscale="log", xlabel="Frequency, Hz")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
        axes.set_title(f"{self.specimen_id}: dynamic stiffness |k|, N/mm", loc="left", fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
        return axes

    def _choose_points(self) -> pd.DataFrame | None:
        """What the model is to be compared with: averaged, else corrected, else measured stiffness."""
        if self.measured is None:
            return None
        rows = self.measured[(self.measured["quantity"] == "stiffness_n_per_mm") & self.measured["usable"].eq(True)]
        stages = (rows[rows["stage"] == stage] for stage in ("averaged", "corrected", "measured"))
        return next((found for found in stages if not found.empty), None)

    def campaign(self, recordings: Sequence[Mapping[str, Any]], *, seed: int = 1) -> str:
        """A campaign file for `dealab simulate`: what this specimen would do in these tests.

        Parameters
        ----------
        recordings : entries `[[recordings]]` without specimen, such as `{"test": "sphs", "drive_kv": 6.0, …}`; see
            `pipeline.simulate.plan` for tests and their parameters
        seed : of the noise

        The film has the fitted relaxation and, where voltages were on it, the fitted force; the rig is the fitted one;
        the extended model takes the effects along that its diagnosis found. Raises `UsageError` where geometry or rig
        are not known well enough to simulate, or the virtual rig has no such effect.
        """
        model, geometry = self.model, self._choose_geometry()
        material: dict[str, Any] = {"k0_n_per_mm": model.k0}
        if model.k:
            material |= {"k_n_per_mm": list(model.k), "tau_s": list(model.tau)}
        if model.c_inf:
            material["c_inf_n_s_per_mm"] = model.c_inf
        material["relative_permittivity"] = self._find_permittivity(geometry)
        tables: dict[str, Mapping[str, Any]] = {
            f"rigs.{_RIG}": self._make_rig_table(),
            "materials.film": {k: v for k, v in material.items() if v is not None},
            f"specimens.{_write_key(self.specimen_id)}": {"rig": _RIG, "material": "film"},
            f"specimens.{_write_key(self.specimen_id)}.geometry": geometry,
        }
        for mechanism, values in translate_severities(self.effects).items():
            tables[f"specimens.{_write_key(self.specimen_id)}.effects.{mechanism}"] = values
        lines = [f"name = {_write_value(f'{self.specimen_id} simulated')}", f"seed = {seed}"]
        lines += ["started_at = 2026-01-01T00:00:00+00:00", ""]
        for name, table in tables.items():
            lines += [f"[{name}]", *(f"{key} = {_write_value(value)}" for key, value in table.items()), ""]
        for entry in recordings:
            lines.append("[[recordings]]")
            own = {"specimens": [self.specimen_id], **entry}
            lines += [f"{key} = {_write_value(value)}" for key, value in own.items()]
            lines.append("")
        return "\n".join(lines)

    def simulate(self, recording: Mapping[str, Any], *, seed: int = 1) -> pd.DataFrame:
        """What this specimen would do in one test: samples of the virtual rig, as `Lab.samples` gives recorded ones.

        `recording` and `seed` as for `campaign`. Force begins at 0: a fit knows nothing of the tension. Raises
        `UsageError` where it is more than one recording, or cannot be simulated.
        """
        import tomllib

        import pandas as pd

        from pipeline.simulate.campaign import read_campaign, simulate_one

        campaign = read_campaign(tomllib.loads(self.campaign([recording], seed=seed)), where="recording")
        if len(campaign.planned) != 1:
            raise UsageError(f"{len(campaign.planned)} recordings at once", expected="one, without vary")
        channels = simulate_one(campaign, campaign.planned[0]).recording.channels
        frame = pd.DataFrame({name: pd.Series(c.values, index=c.time_ns) for name, c in channels.items()})
        start = int(frame.index[0])
        frame.index = ((frame.index - start) / 1e9).rename("time_s")
        units = {name: QUANTITIES[name].unit for name in channels}
        frame.attrs = {"units": units, "recording_id": campaign.planned[0].recording_id, "start_ns": start}
        return frame

    def _choose_geometry(self) -> dict[str, Any]:
        found = {k: _parse_number(v) for k, v in self.geometry.items() if k in GEOMETRY and v not in (None, "")}
        return checked_geometry(found, f"specimen {self.specimen_id}")

    def _find_permittivity(self, geometry: Mapping[str, Any]) -> float | None:
        """The one with which the electrodes give the fitted force; the stated one where no voltage was on them."""
        stated = geometry.get("relative_permittivity")
        if self.force_per_voltage_squared is None or "active_length_mm" not in geometry:
            return None if stated is None else float(stated)
        unit = Material(k0_n_per_mm=self.model.k0 or 1.0, relative_permittivity=1.0)
        film = Specimen(self.specimen_id, _RIG, "film", unit, Deviations(), geometry).film(electrical=True)
        return max(1.0, self.force_per_voltage_squared / film.force_per_voltage_squared)

    def _make_rig_table(self) -> dict[str, Any]:
        """The fitted rig; the filed one where an effect stands for the difference."""
        keys = ("clamp_mass_kg", "load_cell_stiffness_n_per_mm", "load_cell_damping_n_s_per_mm")
        first, second = (self.rig, self.row) if "rig_constants" in self.effects else (self.row, self.rig)
        table = {k: _parse_number(first.get(k) if first.get(k) is not None else second.get(k)) for k in keys}
        table["load_cell_range_n"] = _parse_number(self.rig.get("load_cell_range_n"))
        table = {k: v for k, v in table.items() if v is not None}
        missing = [k for k in keys[:2] if k not in table]
        if missing:
            raise UsageError(
                f"{' and '.join(missing)} of the rig of {self.specimen_id} not known",
                expected="both, to simulate a recording",
            )
        table.setdefault("load_cell_range_n", 10.0)
        if "load_cell_damping_n_s_per_mm" not in table:
            table["damping_ratio"] = 0.01
        return table


def _find_limits(stored: Mapping[str, Any] | None, value: float, sd: float | None) -> tuple[float | None, float | None]:
    """Lower and upper 95 % limit: the fit's own, else by the standard deviation, else none."""
    if stored is not None:
        return stored["lower"], stored["upper"]
    return (None, None) if sd is None else (value - _NORMAL_95 * sd, value + _NORMAL_95 * sd)


def _parse_number(value: Any) -> Any:
    """Numbers that the metadata hold as text."""
    if not isinstance(value, str):
        return value
    try:
        number = float(value)
    except ValueError:
        return value
    return int(number) if number.is_integer() and "." not in value else number


def _write_key(name: str) -> str:
    return json.dumps(name)


def _write_value(value: Any) -> str:
    """A TOML value; strings as JSON writes them, which TOML reads."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=True)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_write_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, Sequence):
        return "[" + ", ".join(_write_value(v) for v in value) + "]"
    return repr(value)
