"""A data file that points at other files of the machine gives nothing of them, whatever kind of link it uses."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

h5py = pytest.importorskip("h5py", reason="the extra `hdf5` is not installed")

from ingest.hdf5_reader import read_hdf5  # noqa: E402
from ingest.hdf5_tree import list_arrays, read_array  # noqa: E402
from ingest.mapping import FileMapping  # noqa: E402

SECRET = 1234.5


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file of somebody else, with numbers as HDF5 and as plain bytes."""
    path = tmp_path / "secret.h5"
    with h5py.File(path, "w") as file:
        file["key"] = np.full(8, SECRET)
        file["group/key"] = np.full(8, SECRET)
    np.full(64, SECRET).tofile(path.with_suffix(".raw"))
    return path


def put_external_link(file: Any, secret: Path) -> None:
    file["out"] = h5py.ExternalLink(str(secret), "/key")


def put_soft_link_to_one(file: Any, secret: Path) -> None:
    file["hidden"] = h5py.ExternalLink(str(secret), "/key")
    file["out"] = h5py.SoftLink("/hidden")


def put_soft_link_through_one(file: Any, secret: Path) -> None:
    file["a/hidden"] = h5py.ExternalLink(str(secret), "/")
    file["a/out"] = h5py.SoftLink("hidden/group/key")


def put_chain_of_soft_links(file: Any, secret: Path) -> None:
    file["hidden"] = h5py.ExternalLink(str(secret), "/")
    file["first"] = h5py.SoftLink("hidden")
    file["second"] = h5py.SoftLink("first/group")
    file["out"] = h5py.SoftLink("second/key")


def put_external_storage(file: Any, secret: Path) -> None:
    file.create_dataset("out", (64,), "f8", external=[(os.fspath(secret.with_suffix(".raw")), 0, h5py.h5f.UNLIMITED)])


def put_external_references(file: Any, secret: Path) -> None:
    place = (os.fspath(secret.with_suffix(".raw")), 0, h5py.h5f.UNLIMITED)
    file.create_dataset("out", (8,), h5py.ref_dtype, external=[place])


def put_virtual(file: Any, secret: Path) -> None:
    layout = h5py.VirtualLayout((8,), "f8")
    layout[:] = h5py.VirtualSource(os.fspath(secret), "key", shape=(8,))
    file.create_virtual_dataset("out", layout)


@pytest.mark.parametrize(
    "put",
    [
        put_external_link,
        put_soft_link_to_one,
        put_soft_link_through_one,
        put_chain_of_soft_links,
        put_external_storage,
        put_external_references,
        put_virtual,
    ],
)
def test_nothing_of_another_file_is_read(put: Any, secret: Path, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["own"] = np.arange(8.0)
        file["link within"] = h5py.SoftLink("/own")
        put(file, secret)
    read = {}
    with h5py.File(tmp_path / "run.h5", "r") as file:
        found = list_arrays(file)
        for name, listed in found.items():
            if not listed.refusal:
                read[name] = np.asarray(read_array(file, listed, matlab=False)).tolist()
    out = next(name for name in found if name.endswith("out"))
    assert "other file" in found[out].refusal or "another file" in found[out].refusal
    assert read == {"own": list(range(8)), "link within": list(range(8))}


def write_netcdf(path: Path, secret: Path, place: str) -> None:
    """A file as netCDF-4 writes it, of which an array, or the scale of all, is the secret one's."""
    with h5py.File(path, "w") as file:
        file.attrs["_NCProperties"] = "version=2,netcdf=4.9.2"
        scale = file.create_dataset("time", data=np.arange(8.0))
        scale.make_scale("time")
        file.create_dataset("force", data=np.arange(8.0), fletcher32=True, shuffle=True).dims[0].attach_scale(scale)
        if place:
            del file[place]
            file[place] = h5py.ExternalLink(str(secret), "/key")


def write_nwb(path: Path, secret: Path, place: str) -> None:
    """A file as Neurodata Without Borders has it: shared times behind a link, references in a table, groups in circles."""
    with h5py.File(path, "w") as file:
        file.attrs[".specloc"] = file.create_group("specifications").ref
        for name in ("force", "displacement"):
            file[f"acquisition/{name}/data"] = np.arange(8.0)
        file["time"] = np.arange(8.0)
        file["acquisition/displacement/timestamps"] = h5py.SoftLink("/time")
        row = np.dtype([("count", "i4"), ("series", h5py.ref_dtype)])
        table = file.create_dataset("trials", (1,), row)
        table[0] = (5, file["acquisition/force"].ref)
        regions = file.create_dataset("regions", (1,), h5py.regionref_dtype)
        regions[0] = file["acquisition/force/data"].regionref[2:5]
        file["acquisition/again"] = file["/"]
        if place:
            del file[place]
            file[place] = h5py.ExternalLink(str(secret), "/key" if place.endswith(("data", "time")) else "/group")


@pytest.mark.parametrize(
    ("write", "place"),
    [
        (write_netcdf, ""), (write_netcdf, "force"), (write_netcdf, "time"),
        (write_nwb, ""), (write_nwb, "acquisition/force/data"), (write_nwb, "acquisition/force"), (write_nwb, "time"),
    ],
)  # fmt: skip
def test_nothing_of_another_file_is_read_through_netcdf_or_nwb(
    write: Any, place: str, secret: Path, tmp_path: Path
) -> None:
    path = tmp_path / "run.h5"
    write(path, secret, place)
    found = read_hdf5(path, FileMapping("recording", None, {}, None, {}, {}, {}))
    read = {name: found.numbers(name).values.tolist() for name in found.names()}
    assert read
    assert all(SECRET not in values for values in read.values())
    assert ("time" in read) == (place != "time")
    refused = {name for name, held in found.held.items() if "another file" in held.refusal}
    assert (place in refused) == bool(place)


def test_what_only_a_reference_leads_to_has_no_path_and_is_named(secret: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["own"] = np.arange(8.0)
        island = file.create_group("island")
        island["itself"], island["numbers"] = island, np.arange(3.0)
        island["out"] = h5py.ExternalLink(str(secret), "/key")
        cells = file.create_dataset("cells", (2,), h5py.ref_dtype)
        cells[:] = [island.ref, island["numbers"].ref]
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        file.create_dataset("nothing", data=h5py.Empty("f8"))
        del file["island"]  # what stands in it keeps it alive
    for matlab in (False, True):
        found = read_hdf5(path, FileMapping("recording", None, {}, None, {}, {}, {}), matlab=matlab)
        assert found.names() == ("own",)
        refusals = {name: held.refusal for name, held in found.held.items() if name[-1] in "01g"}
        nowhere = "something that stands nowhere in the file"
        assert list(refusals.values()) == [nowhere, nowhere, "empty"]


def test_a_sound_file_of_thousands_of_small_arrays_is_listed(tmp_path: Path) -> None:
    path = tmp_path / "many.h5"
    with h5py.File(path, "w", libver="latest") as file:
        for number in range(3000):
            file.create_dataset(f"{number // 100}/{number}", data=np.arange(4.0)).attrs["unit"] = "N"
    found = read_hdf5(path, FileMapping("recording", None, {}, None, {}, {}, {}))
    assert len(found.names()) == 3000
    assert found.unit("7/712") == "N"
