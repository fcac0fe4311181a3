"""Real measured data laid out as a laboratory would have them: files and `recordings.toml` in one folder.

Nothing of the data is kept in the project: the folders hold links to the files and a copy of the mapping beside this
file.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
_DMTA = "pyvisco_dmta"
_OCA = "oca_shear_zhao"

FILES: dict[str, dict[str, str]] = {
    "vhb4910_miles_mcmc": {"vhb4910_data.mat": "vhb4910_data.mat"},
    "hirose_pet_film": {"hirose.csv": "hirose.csv"},
    _DMTA: {
        "freq_master.csv": "verification/freq_master/input_master.csv",
        "freq_raw.csv": "verification/freq_raw/input_master.csv",
        "time_master.csv": "verification/time_master/input_master.csv",
        "freq_user_master.csv": "examples/freq_user_master.csv",
        "freq_user_raw.csv": "examples/freq_user_raw.csv",
        "freq_user_master__shift_factors.csv": "examples/freq_user_master__shift_factors.csv",
        "freq_Eplexor_master.xls": "examples/freq_Eplexor_master.xls",
        "freq_Eplexor_master_shear.xls": "examples/freq_Eplexor_master_shear.xls",
    },
    "pneumatic_actuator_loadcell": {
        **{f"Circle_{p}bar.csv": f"friction/Circle_{p}bar.csv" for p in (1, 2, 4, 6)},
        **{f"{n}_O-ring257_1bar.csv": f"repeatability/reconnected/friction/{n}_O-ring257_1bar.csv" for n in (1, 2, 3)},
    },
    _OCA: {
        **{
            f"monotonic_shear_{r}.xlsx": f"monotonic-shear-test/exp-data/monotonic_shear_{r}.xlsx"
            for r in ("0d01", "0d05", "0d1", "1")
        },
        **{
            f"shear_relaxation{r}.xlsx": f"cyclic-shear-relaxation-test/exp-data/shear_relaxation{r}.xlsx"
            for r in ("_0d1", "_1", "_2", "_5")
        },
    },
    "silverbox": {"SNLS80mV.csv": "SNLS80mV.csv"},
    "lifelines_km": {
        name: name for name in ("anderson.csv", "waltons_dataset.csv", "larynx.csv", "CuZn-LeftCensoredDataset.csv")
    },
}
"""By data set: name in the laid-out folder, path in the data set."""
SILVERBOX, FIRST, LAST = "silverbox", 10585, 11608
"""Samples, from 1, of one period of its multisine, as its authors say."""
RHEOMETER = "hermes_rheo_ta_lims"
EXPORT = "tutorial_notebooks/tutorial_data/tutorial_4/frequency_sweep_tts.txt"


def steps_of_export(path: Path) -> dict[str, str]:
    """Frequency sweeps of a rheometer's export, each as a table of its own: "minus40C.tsv" → header, units, rows."""
    tables: dict[str, list[str]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        kind, _, rest = line.partition("\t")
        if kind == "Step name":
            temperature = float(rest.split("(")[1].split()[0])
            name = f"{'minus' if temperature < 0 else ''}{abs(temperature):.0f}C.tsv"
            tables[name] = []
        elif kind in ("Variables", "Units", "Data point"):
            tables[name].append(rest)
    return {name: "\n".join(rows) + "\n" for name, rows in tables.items()}


def parts(dataset: str, source: Path) -> dict[str, str]:
    """Files that are laid out as parts of files of the data set: name → content."""
    if dataset == RHEOMETER:
        return steps_of_export(source / EXPORT)
    if dataset == SILVERBOX:
        lines = (source / "Schroeder80mV.csv").read_text(encoding="utf-8").splitlines(keepends=True)
        return {"Schroeder80mV-period.csv": "".join([lines[0], *lines[FIRST : LAST + 1]])}
    return {}


def lay_out(dataset: str, source: Path, folder: Path) -> None:
    """A data set as a laboratory would have it: links, parts, and the mapping, in a new folder."""
    folder.mkdir()
    for name, path in FILES.get(dataset, {}).items():
        (folder / name).symlink_to(source / path)
    for name, text in parts(dataset, source).items():
        (folder / name).write_text(text, encoding="utf-8")
    shutil.copyfile(HERE / f"{dataset}.toml", folder / "recordings.toml")


@pytest.fixture
def real_folder(real_data: Path, tmp_path: Path) -> Callable[[str], Path]:
    """Lays a data set out in a temporary folder; the test is skipped where the data set is absent."""

    def laid_out(dataset: str) -> Path:
        source = real_data / dataset
        if not source.is_dir():
            pytest.skip(f"DEALAB_REAL_DATA: no folder {dataset}")
        lay_out(dataset, source, tmp_path / dataset)
        return tmp_path / dataset

    return laid_out
