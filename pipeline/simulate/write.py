"""A simulated campaign as files: what the rigs' computers would have left in a folder, accidents included.

One folder per specimen or group, `rigs/<rig_id>.toml` beside them, and a hidden file that lists what was written, so that
a later simulation knows what it may replace. What is true behind the recordings goes to a file of its own, and only
outside of that folder. Does not belong here: physics.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import secrets
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ingest.mcap_writer import RecordingWriter
from pipeline.simulate.blind import hide_names
from pipeline.simulate.campaign import SimulatedRecording, simulate, tell_truth
from pipeline.simulate.plan import Campaign, Mishap, Planned, load_campaign
from schemas.arrays import Float
from schemas.errors import UsageError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.quantities import QUANTITIES
from schemas.recording import Recording
from schemas.units import conversion

MARKER = ".dealab-simulation"
"""Name of the hidden file that lists what a simulation wrote."""
_SLICE_S = 1.0
"""The channels are written in turns of this length, as a rig writes them while the test runs."""
_HEADINGS = {"displacement": "Weg", "force": "Kraft", "voltage": "Spannung", "stretch": "Dehnung"}


@dataclass(frozen=True)
class Written:
    """What a simulation left: files and their total size."""

    files: tuple[Path, ...]
    size: int


def simulate_command(
    campaign: Path | str,
    out: Path,
    truth: Path | None = None,
    watch: Callable[[Recording], object] = lambda recording: None,
    *,
    blind: bool = False,
    night: int | None = None,
) -> int:
    """`dealab simulate`: writes a campaign (a TOML file or the name of a packaged one) to the folder `out`.

    Progress goes to stderr, the summary to stdout. `truth`: JSON file with what is true behind each recording; `watch`
    is shown every recording; `blind`: with names, order and noise that are drawn; `night`: only what is recorded before that night, beside
    what was recorded before the nights before it. Returns the exit status. Raises `UsageError` for a campaign that does not parse, an `out`
    that holds anything but an earlier simulation, a `truth` inside of `out`, a night that the campaign has not, or `blind` without a `truth`,
    which nobody could find again.
    """
    from tqdm import tqdm

    if blind and truth is None:
        raise UsageError(
            "--blind without --truth", expected="a file for what is true: names and noise are drawn anew each time"
        )
    loaded = load_campaign(campaign)
    if blind:
        loaded = hide_names(loaded, secrets.randbelow(2**32))
    chosen = choose_night(loaded, night)
    with tqdm(total=len(chosen), desc="simulating", unit="recording", file=sys.stderr, disable=None) as bar:

        def after_each(simulated: SimulatedRecording) -> None:
            bar.update()
            watch(simulated.recording)

        written = write_campaign(loaded, out, truth=truth, night=night, after_each=after_each)
    count = len(chosen)
    of_night = "" if night is None else f", night {night}"
    print(
        f"{count} recording{'' if count == 1 else 's'} of campaign {loaded.name}{of_night} in {out}"
        f" ({written.size / 1e6:.0f} MB)"
    )
    if truth is not None:
        print(f"what is true behind them: {truth}")
    return 0


def write_campaign(
    campaign: Campaign,
    out: Path,
    *,
    truth: Path | None = None,
    night: int | None = None,
    after_each: Callable[[SimulatedRecording], object] = lambda simulated: None,
) -> Written:
    """Writes the recordings of a campaign, all or of one night, the rigs' files and the accidents. Raises as `simulate_command`."""
    if truth is not None and truth.resolve().is_relative_to(out.resolve()):
        raise UsageError(f"the truth would lie among the recordings, in {truth}", expected=f"a file outside of {out}")
    mishaps: dict[str, list[Mishap]] = {}
    for mishap in campaign.mishaps:
        mishaps.setdefault(mishap.recording, []).append(mishap)
    chosen = choose_night(campaign, night)

    def list_files(several: Iterable[Planned]) -> list[str]:
        return [name for planned in several for name in _names(planned, mishaps.get(planned.recording_id, []))]

    files_of_rigs = [f"rigs/{name}.toml" for name in campaign.rigs]
    names = list_files(chosen) + files_of_rigs
    before = [] if night is None else [p for p in campaign.planned if p.night < night]
    earlier = list_files(before)
    if earlier:
        _require_earlier(out, campaign, [*earlier, *files_of_rigs])
    else:
        _clear(out)
    known = _list_ours(out)
    _mark(out, {*earlier, *names}, known)
    (out / "rigs").mkdir(exist_ok=True)
    for name, rig in campaign.rigs.items():
        path = out / "rigs" / f"{name}.toml"
        # Later nights find the file of the first, as somebody may have corrected it.
        if not (earlier and path.is_file()):
            path.write_text(rig_file(rig.stated), encoding="utf-8")
    truths: list[Mapping[str, Any]] = [tell_truth(campaign, planned) for planned in before]
    for simulated in simulate(campaign, chosen):
        _write(simulated, out, mishaps.get(simulated.recording_id, []))
        truths.append(simulated.truth)
        after_each(simulated)
    if truth is not None:
        truth.parent.mkdir(parents=True, exist_ok=True)
        content = {"campaign": campaign.name, "seed": campaign.seed, "recordings": truths}
        truth.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    files = tuple(out / name for name in sorted(names))
    _mark(out, {*earlier, *names}, known)
    return Written(files, sum(path.stat().st_size for path in files))


def choose_night(campaign: Campaign, night: int | None) -> list[Planned]:
    """What is recorded before one night, or all. Raises `UsageError` for a night that the campaign has not."""
    if night is None:
        return list(campaign.planned)
    nights = sorted({planned.night for planned in campaign.planned})
    if night not in nights:
        raise UsageError(
            f"campaign {campaign.name} has no night {night}", expected="one of " + ", ".join(str(n) for n in nights)
        )
    return [planned for planned in campaign.planned if planned.night == night]


def _list_ours(out: Path) -> dict[str, str]:
    """Names of the files that earlier simulations wrote into a folder, the list of them among these, with the digests of those that people
    edit; an empty digest where none is known. Empty where there is no list."""
    marker = out / MARKER
    if not marker.is_file():
        return {}
    lines = (line.partition("\t") for line in marker.read_text(encoding="utf-8").splitlines())
    return {name: digest for name, _, digest in lines} | {MARKER: ""}


def _mark(out: Path, names: Iterable[str], known: Mapping[str, str]) -> None:
    """Lists what simulations wrote into a folder. Digests stay those that are known: what was edited since is no simulation's."""
    lines = []
    for name in sorted(names):
        path = out / name
        digest = known.get(name, "") or (_digest(path) if _is_for_people(name) and path.is_file() else "")
        lines.append(f"{name}\t{digest}" if digest else name)
    (out / MARKER).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _is_for_people(name: str) -> bool:
    """Whether people edit a file: constants of a rig, a mapping."""
    return name.endswith(".toml")


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _require_earlier(out: Path, campaign: Campaign, names: list[str]) -> None:
    """What was recorded before has to be there. Raises `UsageError`."""
    if not _list_ours(out).keys() >= set(names):
        raise UsageError(
            f"{out} does not hold the nights of campaign {campaign.name} before this one",
            expected="a folder to which they were simulated",
            remedy="Simulate them first: --night 1, and so on",
        )


def _names(planned: Planned, mishaps: list[Mishap]) -> list[str]:
    """Names of the files of one recording, relative to the output folder."""
    kinds = {mishap.kind for mishap in mishaps}
    stem = f"{planned.folder}/{planned.recording_id}"
    names = [f"{stem}.{planned.format}"]
    if planned.format == "csv" and "unmapped" not in kinds:
        names.append(f"{stem}.csv.toml")
    if "duplicate" in kinds:
        names.append(f"{stem}-copy.{planned.format}")
    return names


def _clear(out: Path) -> None:
    """An empty folder; only files of an earlier simulation are removed."""
    if not out.exists():
        out.mkdir(parents=True)
        return
    if not out.is_dir():
        raise UsageError(f"{out} is not a folder", expected="a new folder, or one of an earlier simulation")
    ours = _list_ours(out)
    present = sorted(path for path in out.rglob("*") if path.is_symlink() or not path.is_dir())
    for path in present:
        name = path.relative_to(out).as_posix()
        # A recording whose writing was interrupted still has its temporary name.
        if path.is_symlink() or name.removesuffix(".part") not in ours:
            raise UsageError(
                f"{out} holds {name}, which no simulation wrote",
                expected="a new folder, or one of an earlier simulation",
                remedy="Give another folder with --out",
            )
        if ours.get(name) and ours[name] != _digest(path):
            raise UsageError(
                f"{path} was edited after a simulation wrote it",
                expected="files as they were written",
                remedy="Move it away to have it written anew, or give another folder with --out",
            )
    for path in present:
        path.unlink()
    for folder in sorted((p for p in out.rglob("*") if p.is_dir()), reverse=True):
        folder.rmdir()


def rig_file(rig: RigConstants) -> str:
    """The text of `<rig_id>.toml`."""
    lines = []
    for key, value in rig.to_text().items():
        lines.append(f"{key} = {json.dumps(value) if key == 'rig_id' else value}")
    return "\n".join(lines) + "\n"


def _write(simulated: SimulatedRecording, out: Path, mishaps: list[Mishap]) -> None:
    folder = out / simulated.folder
    folder.mkdir(exist_ok=True)
    path = folder / f"{simulated.recording_id}.{simulated.format}"
    by_kind = {mishap.kind: mishap for mishap in mishaps}
    metadata = simulated.recording.metadata
    if "missing_key" in by_kind:
        # Not a value that the type allows: the point is a file that breaks the rules.
        lacking: dict[str, Any] = {by_kind["missing_key"].key: None}
        metadata = dataclasses.replace(metadata, **lacking)
    flipped = by_kind.get("flipped")
    if flipped is not None:
        simulated = _with_opposite_sign(simulated, flipped.quantity)
    if simulated.format == "mcap":
        _write_mcap(simulated, metadata, path)
    else:
        path.write_bytes(_csv(simulated))
        if "unmapped" not in by_kind:
            wrong = by_kind.get("wrong_unit")
            units = {} if wrong is None else {wrong.quantity: wrong.unit}
            mapping = _mapping(simulated, metadata, units)
            path.with_name(path.name + ".toml").write_text(mapping, encoding="utf-8")
    if "truncated" in by_kind:
        whole = path.read_bytes()
        path.write_bytes(whole[: int(len(whole) * by_kind["truncated"].share)])
    if "duplicate" in by_kind:
        shutil.copyfile(path, path.with_name(f"{path.stem}-copy{path.suffix}"))


def _with_opposite_sign(simulated: SimulatedRecording, quantity: str) -> SimulatedRecording:
    channels = dict(simulated.recording.channels)
    channels[quantity] = dataclasses.replace(channels[quantity], values=-channels[quantity].values)
    return dataclasses.replace(simulated, recording=dataclasses.replace(simulated.recording, channels=channels))


def _unit(simulated: SimulatedRecording, quantity: str) -> str:
    return simulated.units.get(quantity, QUANTITIES[quantity].unit)


def _in_unit(simulated: SimulatedRecording, quantity: str) -> Float:
    convert = conversion(_unit(simulated, quantity), QUANTITIES[quantity].unit)
    return (simulated.recording.channels[quantity].values - convert.offset) / convert.scale


def _write_mcap(simulated: SimulatedRecording, metadata: RecordingMetadata, path: Path) -> None:
    channels = simulated.recording.channels
    with RecordingWriter(path, metadata) as writer:
        columns = []
        for quantity, channel in channels.items():
            unit = _unit(simulated, quantity)
            scale = conversion(unit, QUANTITIES[quantity].unit).scale
            writer.add_channel(
                quantity,
                unit,
                resolution=None if channel.resolution is None else channel.resolution / scale,
                filter_hz=channel.filter_hz,
                delay_s=channel.delay_s,
                sensor=channel.sensor,
            )
            interval = float(channel.time_ns[-1] - channel.time_ns[0]) * 1e-9 / max(channel.time_ns.size - 1, 1)
            columns.append((quantity, channel.time_ns, _in_unit(simulated, quantity), interval))
        for turn in range(int(np.ceil(simulated.recording.duration_s / _SLICE_S)) + 1):
            for quantity, times, values, interval in columns:
                per_turn = max(round(_SLICE_S / interval), 1)
                part = slice(turn * per_turn, (turn + 1) * per_turn)
                if values[part].size:
                    writer.append(quantity, int(times[part][0]), interval, values[part])


def _csv(simulated: SimulatedRecording) -> bytes:
    """Text as an older acquisition program exports it: preamble, unit row, semicolons, decimal comma, code page 1252."""
    channels = simulated.recording.channels
    first = next(iter(channels.values()))
    elapsed = (first.time_ns - first.time_ns[0]) * 1e-9
    columns = [elapsed, *(_in_unit(simulated, quantity) for quantity in channels)]
    head = [
        "Messprogramm 4.2",
        f"Probe;{simulated.recording.metadata.specimen_id}",
        ";".join(["Zeit", *(_HEADINGS.get(q, q) for q in channels)]),
        ";".join(["s", *(_unit(simulated, q) for q in channels)]),
    ]
    rows = [";".join(f"{value:.9g}" for value in row).replace(".", ",") for row in zip(*columns, strict=True)]
    return ("\r\n".join([*head, *rows]) + "\r\n").encode("cp1252")


def _mapping(simulated: SimulatedRecording, metadata: RecordingMetadata, wrong_units: Mapping[str, str]) -> str:
    """The TOML beside the CSV."""
    lines = ['kind = "recording"']
    dialect: dict[str, Any] = {
        "delimiter": ";",
        "decimal": ",",
        "encoding": "cp1252",
        "skip_rows": 2,
        "header": True,
        "unit_row": True,
    }
    lines += ["[csv]", *(f"{key} = {json.dumps(value)}" for key, value in dialect.items())]
    lines += ["[time]", 'column = "Zeit"', 'unit = "s"']
    for quantity in simulated.recording.channels:
        unit = wrong_units.get(quantity, _unit(simulated, quantity))
        heading = _HEADINGS.get(quantity, quantity)
        lines += [f"[columns.{quantity}]", f"column = {_quoted(heading)}", f"unit = {_quoted(unit)}"]
    lines.append("[recording]")
    lines += [f"{key} = {_quoted(value)}" for key, value in metadata.to_text().items()]
    return "\n".join(lines) + "\n"


def _quoted(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
