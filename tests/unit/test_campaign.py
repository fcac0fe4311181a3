"""Campaign files: strict reading, planning, determinism, and what is written where."""

from __future__ import annotations

import copy
import hashlib
import json
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.simulate import plan
from pipeline.simulate.campaign import load_campaign, packaged_campaigns, read_campaign, simulate, simulate_one
from pipeline.simulate.write import MARKER, simulate_command, write_campaign
from schemas.errors import UsageError
from schemas.mechanisms import FAULTS, MECHANISMS
from schemas.metadata import RigConstants

TABLE: dict[str, Any] = tomllib.loads(
    """
name = "small"
seed = 4
started_at = 2024-03-04T08:00:00+01:00
pause_s = 60
[rigs.bench]
clamp_mass_kg = 0.1874
load_cell_stiffness_n_per_mm = 20.0
damping_ratio = 0.005
channels.displacement = { unit = "µm", sensor = "vibrometer" }
[rigs.bench.file]
load_cell_stiffness_n_per_mm = 20.2
load_cell_stiffness_n_per_mm_sd = 0.3
[materials.acrylic]
k0_n_per_mm = 1.0
k_n_per_mm = [1.5]
tau_s = [0.02]
[specimens.A]
rig = "bench"
material = "acrylic"
pretension_n = 0.5
geometry = { film_length_mm = 50.0, film_thickness_mm = 1.0, stretch_1 = 1.4 }
[specimens.B]
rig = "bench"
material = "acrylic"
stiffness_scale = 1.1
pretension_n = 0.5
geometry = { film_length_mm = 50.0, film_thickness_mm = 1.0, stretch_1 = 1.4 }
effects.gain_error = { gain = 0.02 }
[[recordings]]
test = "step_mechanical"
specimens = ["A", "B"]
id = "{specimen}-hold-{step_mm}mm"
sample_rate_hz = 200
hold_s = 2.0
vary = { step_mm = [0.1, 0.2] }
[[recordings]]
test = "step_mechanical"
specimens = ["A"]
id = "export-{n}"
sample_rate_hz = 200
format = "csv"
hold_s = 1.0
step_mm = 0.1
vary = { ramp_s = [0.02, 0.04, 0.06] }
[[recordings]]
test = "step_mechanical"
specimens = ["B"]
id = "accident-{n}"
sample_rate_hz = 200
hold_s = 4.0
step_mm = 0.1
vary = { ramp_s = [0.02, 0.04] }
[[mishaps]]
recording = "export-2"
kind = "unmapped"
[[mishaps]]
recording = "export-3"
kind = "wrong_unit"
unit = "mm"
[[mishaps]]
recording = "accident-1"
kind = "truncated"
[[mishaps]]
recording = "accident-2"
kind = "missing_key"
[[mishaps]]
recording = "A-hold-0.1mm"
kind = "duplicate"
"""
)


def edited(path: str, value: Any) -> dict[str, Any]:
    """The table with one value set, added, or removed (None); the path's numbers count in arrays."""
    table = copy.deepcopy(TABLE)
    *keys, last = [int(k) if k.isdigit() else k for k in path.split("/")]
    place: Any = table
    for key in keys:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return table


def test_recordings_are_planned_one_after_the_other() -> None:
    campaign = read_campaign(TABLE)
    ids = [planned.recording_id for planned in campaign.planned]
    assert ids[:4] == ["A-hold-0.1mm", "A-hold-0.2mm", "B-hold-0.1mm", "B-hold-0.2mm"]
    assert ids[4:] == ["export-1", "export-2", "export-3", "accident-1", "accident-2"]
    first, second = campaign.planned[:2]
    assert first.started_at == datetime(2024, 3, 4, 7, 0, tzinfo=UTC)
    # 1 s rest, 0.02 s ramp, 2 s hold, 60 s pause, to the next whole second
    assert (second.started_at - first.started_at).total_seconds() == 64


def test_a_recording_says_what_the_file_says_and_the_truth_what_is_true() -> None:
    campaign = read_campaign(TABLE)
    simulated = {s.recording_id: s for s in simulate(campaign)}
    one = simulated["B-hold-0.2mm"]
    assert one.recording.rig.load_cell_stiffness_n_per_mm == 20.2
    assert one.recording.rig.noise_sd["force"] == 0.001
    assert one.truth["rig"]["load_cell_stiffness_n_per_mm"] == 20.0
    assert one.truth["film"]["k0"] == pytest.approx(1.1)
    assert one.truth["effects"] == {"gain_error": {"gain": 0.02}}
    metadata = one.recording.metadata
    assert (metadata.protocol, metadata.loading, metadata.specimen_id) == ("step", "mechanical", "B")
    assert metadata.strain_pp == pytest.approx(0.2 / 70)
    channels = one.recording.channels
    assert set(channels) == {"displacement", "force"}
    assert channels["displacement"].sensor == "vibrometer"
    assert channels["force"].resolution == 2.0**-14
    assert np.all(np.diff(channels["force"].time_ns) == 5_000_000)


def test_order_does_not_matter_and_a_seed_does() -> None:
    campaign = read_campaign(TABLE)
    forwards = {s.recording_id: s.recording for s in simulate(campaign)}
    for planned in reversed(campaign.planned):
        again = simulate_one(campaign, planned).recording
        for quantity, channel in again.channels.items():
            assert np.array_equal(channel.values, forwards[planned.recording_id].channels[quantity].values)
    other = next(iter(simulate(read_campaign(edited("seed", 5))))).recording
    same = forwards["A-hold-0.1mm"]
    difference = other.channels["force"].values - same.channels["force"].values
    assert np.std(difference) == pytest.approx(np.sqrt(2) * 1e-3, rel=0.15)
    alone = edited("recordings", TABLE["recordings"][1:2])
    alone["mishaps"] = []
    for s in simulate(read_campaign(alone)):
        assert np.array_equal(s.recording.channels["force"].values, forwards[s.recording_id].channels["force"].values)


@pytest.mark.parametrize(
    ("path", "value", "place", "words"),
    [
        ("seed", 1.5, "campaign", "seed"),
        ("seed", None, "campaign", "seed is missing"),
        ("started_at", "2024-03-04T08:00:00", "campaign", "zone"),
        ("colour", "red", "campaign", '"colour" is not a key'),
        ("rigs/bench/clamp_mass_kg", -1, "rigs.bench", "a number above 0"),
        ("rigs/bench/clamp_mass", 1, "rigs.bench", '"clamp_mass_kg"?'),
        ("rigs/bench/load_cell_damping_n_s_per_mm", 1e-3, "rigs.bench", "one of"),
        ("rigs/bench/file/load_cell", 1, "rigs.bench.file", '"load_cell" is not a key'),
        ("rigs/bench/file/clamp_mass_kg", "heavy", "rigs.bench", "heavy"),
        ("rigs/bench/channels/force", {"unit": "mm"}, "channels.force", "length"),
        ("rigs/bench/channels/force", {"bits": 1.5}, "channels.force", "whole number"),
        ("rigs/bench/channels/torque", {}, "channels", '"torque" is not a key'),
        ("materials/acrylic/tau_s", [0.1, 0.2], "materials.acrylic", "1 springs but 2"),
        ("materials/acrylic/c_n_s_per_mm", [0.1], "materials.acrylic", "one of tau_s"),
        ("specimens/A/material", "steel", "specimens.A", "one of acrylic"),
        ("specimens/A/geometry/stretch_1", "long", "specimens.A.geometry", "stretch_1"),
        ("specimens/A/geometry/operator", "me", "specimens.A.geometry", '"operator" is not a key'),
        ("specimens/A/effects", {"slack": {}}, "specimens.A.effects", "no effect"),
        ("specimens/B/effects/gain_error/gain", "big", "effects.gain_error", "a number"),
        ("specimens/B/effects/gain_error/channel", "torque", "effects.gain_error", "one of force"),
        ("recordings/0/test", "squeeze", "recordings[0]", "one of chirp"),
        ("recordings/0/specimens", ["A", "C"], "recordings[0]", "one of A, B"),
        ("recordings/0/specimens", None, "recordings[0]", "names its specimens"),
        ("recordings/0/hold_s", None, "recordings[0]", "hold_s is missing"),
        ("recordings/0/hold", 2.0, "recordings[0]", '"hold_s"?'),
        ("recordings/0/vary/step_mm", 0.1, "recordings[0]", "a list of values"),
        ("recordings/0/id", "{specimen}", "campaign", "occurs twice"),
        ("recordings/0/id", "{colour}", "recordings[0]", "{colour}"),
        ("recordings/0/id", "../{specimen}-{step_mm}", "recordings[0]", "the id becomes"),
        ("recordings/0/folder", "../elsewhere", "recordings[0]", "folder"),
        ("recordings/0/format", "xlsx", "recordings[0]", "one of mcap, csv"),
        ("mishaps/0/recording", "nobody", "mishaps[0]", "not in the campaign"),
        ("mishaps/0/recording", "A-hold-0.1mm", "mishaps[0]", "csv"),
        ("recordings/0/night", 0, "recordings[0]", "whole number of at least 1"),
        ("mishaps/0", {"recording": "export-2", "kind": "mislabelled", "specimen": "C"}, "mishaps[0]", "filed under"),
        ("mishaps/0", {"recording": "export-2", "kind": "flipped", "quantity": "voltage"}, "mishaps[0]", "no voltage"),
        ("mishaps/3/key", "material", "mishaps[3]", "one of recording_id"),
        ("recordings", [], "campaign", "no recordings"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(path: str, value: Any, place: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        read_campaign(edited(path, value))
    assert place in caught.value.where
    assert words in str(caught.value)


def test_tests_refuse_specimens_that_they_do_not_suit() -> None:
    for entry, words in (
        ({"test": "sphs", "specimens": ["A"], "drive_kv": 5.0}, "active_length_mm is missing"),
        ({"test": "chirp", "specimens": ["A"], "amplitude_mm": 0.1, "rest_s": 0.01}, "3 × the longest"),
        ({"test": "chirp", "specimens": ["A"], "amplitude_mm": 0.1, "frequency_stop_hz": 0.5}, "not above"),
        ({"test": "tap", "specimens": ["A"]}, "without specimen"),
        ({"test": "chirp", "rigs": ["bench"], "amplitude_mm": 0.1}, "needs a specimen"),
    ):
        table = edited("recordings", [entry])
        table["mishaps"] = []
        if entry["test"] == "sphs":
            table["materials"]["acrylic"]["relative_permittivity"] = 4.7
        with pytest.raises(UsageError, match=words):
            read_campaign(table)


def test_files_that_are_no_campaigns(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="thesis"):
        load_campaign(tmp_path / "nothing.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("name = ")
    with pytest.raises(UsageError, match="not a TOML file"):
        load_campaign(broken)
    broken.write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError, match="not a TOML file"):
        load_campaign(broken)


def digests(folder: Path) -> dict[str, str]:
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.rglob("*") if p.is_file()
    }


def test_files_are_written_with_their_accidents_and_the_truth_elsewhere(tmp_path: Path) -> None:
    campaign = read_campaign(TABLE)
    out, truth = tmp_path / "raw", tmp_path / "truth.json"
    written = write_campaign(campaign, out, truth=truth)
    names = {p.relative_to(out).as_posix() for p in written.files}
    assert names == {
        "rigs/bench.toml",
        *(f"{s}/{s}-hold-{mm}mm.mcap" for s in "AB" for mm in ("0.1", "0.2")),
        "A/A-hold-0.1mm-copy.mcap",
        *(f"A/export-{n}.csv" for n in (1, 2, 3)),
        "A/export-1.csv.toml",
        "A/export-3.csv.toml",
        "B/accident-1.mcap",
        "B/accident-2.mcap",
    }
    assert {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()} == names | {MARKER}
    assert written.size == sum(p.stat().st_size for p in written.files)
    copies = [(out / "A" / f"A-hold-0.1mm{suffix}.mcap").read_bytes() for suffix in ("", "-copy")]
    assert copies[0] == copies[1]
    magic = b"\x89MCAP0\r\n"
    assert (out / "B" / "accident-2.mcap").read_bytes().endswith(magic)
    assert not (out / "B" / "accident-1.mcap").read_bytes().endswith(magic)
    assert b"specimen_id" not in (out / "B" / "accident-2.mcap").read_bytes()
    rig = RigConstants.parse(tomllib.loads((out / "rigs" / "bench.toml").read_text(encoding="utf-8")))
    assert (rig.load_cell_stiffness_n_per_mm, rig.load_cell_stiffness_n_per_mm_sd) == (20.2, 0.3)
    assert tomllib.loads((out / "A" / "export-3.csv.toml").read_text("utf-8"))["columns"]["force"]["unit"] == "mm"
    known = json.loads(truth.read_text())
    assert [r["recording_id"] for r in known["recordings"]] == [p.recording_id for p in campaign.planned]
    assert known["recordings"][0]["rig"]["load_cell_stiffness_n_per_mm"] == 20.0


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    from ingest.canonical import canonical
    from ingest.mapping import find_mapping
    from ingest.read import read_raw

    campaign = read_campaign(TABLE)
    write_campaign(campaign, tmp_path / "raw")
    simulated = {s.recording_id: s.recording for s in simulate(campaign)}
    for name in ("B/B-hold-0.2mm.mcap", "A/export-1.csv"):
        path = tmp_path / "raw" / name
        raw = read_raw(path, find_mapping(path) if path.suffix == ".csv" else None)
        found, expected = canonical(raw, where=name), simulated[path.stem]
        assert found.metadata == expected.metadata
        assert found.problems == ()
        for quantity, channel in expected.channels.items():
            assert np.array_equal(found.channels[quantity].time_ns, channel.time_ns)
            assert found.channels[quantity].values == pytest.approx(channel.values, rel=1e-8, abs=1e-9)


def test_a_simulation_replaces_an_earlier_one_and_nothing_else(tmp_path: Path) -> None:
    out = tmp_path / "raw"
    write_campaign(read_campaign(TABLE), out)
    first = digests(out)
    write_campaign(read_campaign(TABLE), out)
    assert digests(out) == first
    fewer = edited("recordings", TABLE["recordings"][:1])
    fewer["mishaps"] = []
    write_campaign(read_campaign(fewer), out)
    assert set(digests(out)) == {
        MARKER,
        "rigs/bench.toml",
        *(f"{s}/{s}-hold-{mm}mm.mcap" for s in "AB" for mm in (0.1, 0.2)),
    }
    measured = out / "A" / "measured.mcap"
    measured.write_bytes(b"precious")
    before = digests(out)
    with pytest.raises(UsageError, match=r"measured\.mcap"):
        write_campaign(read_campaign(TABLE), out)
    assert digests(out) == before
    other = tmp_path / "other"
    other.mkdir()
    (other / "data.csv").write_text("1")
    with pytest.raises(UsageError, match=r"data\.csv"):
        write_campaign(read_campaign(TABLE), other)
    with pytest.raises(UsageError, match="not a folder"):
        write_campaign(read_campaign(TABLE), other / "data.csv")
    with pytest.raises(UsageError, match="among the recordings"):
        write_campaign(read_campaign(TABLE), tmp_path / "new", truth=tmp_path / "new" / "truth.json")
    assert not (tmp_path / "new").exists()


def test_a_file_that_somebody_edited_is_never_written_over(tmp_path: Path) -> None:
    """Constants that a page asked for were corrected, and a second run of the demonstration lost them."""
    campaign, out = read_campaign(edited("recordings/1/night", 2)), tmp_path / "raw"
    write_campaign(campaign, out, night=1)
    rig = next((out / "rigs").glob("*.toml"))
    corrected = rig.read_text().replace("clamp_mass_kg", "# corrected\nclamp_mass_kg", 1)
    rig.write_text(corrected)
    write_campaign(campaign, out, night=2)
    assert rig.read_text() == corrected
    before = digests(out)
    with pytest.raises(UsageError, match=f"{rig.name} was edited after"):
        write_campaign(campaign, out, night=1)
    assert digests(out) == before, "nothing is removed"
    rig.unlink()
    write_campaign(campaign, out, night=1)
    assert "# corrected" not in rig.read_text()


def test_nights_are_written_one_beside_the_other(tmp_path: Path) -> None:
    table = edited("recordings/1/night", 2)
    campaign = read_campaign(table)
    first, second = ([p for p in campaign.planned if p.night == night] for night in (1, 2))
    assert {p.recording_id for p in second} == {"export-1", "export-2", "export-3"}
    assert max(p.started_at for p in first) < min(p.started_at for p in second)
    whole, by_night = tmp_path / "whole", tmp_path / "raw"
    write_campaign(campaign, whole)
    with pytest.raises(UsageError, match="does not hold the nights"):
        write_campaign(campaign, by_night, night=2)
    write_campaign(campaign, by_night, night=1)
    assert not {name for name in digests(by_night) if "export" in name}
    write_campaign(campaign, by_night, night=2, truth=tmp_path / "truth.json")
    assert digests(by_night) == digests(whole)
    told = json.loads((tmp_path / "truth.json").read_text())["recordings"]
    assert sorted(t["recording_id"] for t in told) == sorted(p.recording_id for p in campaign.planned)
    with pytest.raises(UsageError, match="no night 3"):
        write_campaign(campaign, by_night, night=3)


def test_a_recording_is_filed_under_another_specimen(tmp_path: Path) -> None:
    table = edited("mishaps", [{"recording": "A-hold-0.2mm", "kind": "mislabelled", "specimen": "B"}])
    campaign = read_campaign(table)
    made = next(s for s in simulate(campaign) if s.recording_id == "A-hold-0.2mm")
    assert (made.recording.metadata.specimen_id, made.folder, made.truth["specimen_id"]) == ("B", "B", "A")
    right = next(s for s in simulate(read_campaign(TABLE)) if s.recording_id == "A-hold-0.2mm")
    assert np.array_equal(made.recording.channels["force"].values, right.recording.channels["force"].values)
    write_campaign(campaign, tmp_path)
    assert (tmp_path / "B" / "A-hold-0.2mm.mcap").is_file()


@pytest.mark.parametrize("name", ["A-hold-0.2mm", "export-1"])
def test_a_flipped_channel_is_written_with_the_opposite_sign_and_nothing_else(tmp_path: Path, name: str) -> None:
    from ingest.canonical import canonical
    from ingest.mapping import find_mapping
    from ingest.read import read_raw

    table = edited("mishaps", [{"recording": name, "kind": "flipped", "quantity": "force"}])
    campaign = read_campaign(table)
    write_campaign(campaign, tmp_path)
    (path,) = (p for p in (tmp_path / "A").iterdir() if p.stem == name and p.suffix != ".toml")
    found = canonical(read_raw(path, find_mapping(path) if path.suffix == ".csv" else None), where=name)
    simulated = next(s.recording for s in simulate(campaign) if s.recording_id == name)
    written = {quantity: channel.values for quantity, channel in found.channels.items()}
    assert written["force"] == pytest.approx(-simulated.channels["force"].values, rel=1e-8, abs=1e-9)
    assert written["displacement"] == pytest.approx(simulated.channels["displacement"].values, rel=1e-8, abs=1e-9)


def test_the_command_takes_a_file_or_a_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "mini.toml"
    file.write_text(
        'name = "mini"\nseed = 1\nstarted_at = 2024-01-01T00:00:00Z\n'
        "[rigs.r]\nclamp_mass_kg = 0.2\nload_cell_stiffness_n_per_mm = 20.0\ndamping_ratio = 0.01\n"
        '[[recordings]]\ntest = "tap"\nrigs = ["r"]\nid = "tap"\n'
    )
    assert simulate_command(file, tmp_path / "raw") == 0
    assert "1 recording of campaign mini" in capsys.readouterr().out
    monkeypatch.setattr(plan, "PACKAGED", tmp_path)
    assert simulate_command("mini", tmp_path / "raw", tmp_path / "truth.json") == 0
    assert (tmp_path / "truth.json").is_file()


def test_the_campaign_of_the_thesis_is_sound() -> None:
    assert "thesis" in packaged_campaigns()
    campaign = load_campaign("thesis")
    protocols = {planned.procedure.protocol for planned in campaign.planned}
    assert protocols == {"tap", "weight", "chirp", "step", "sphs", "cyclic", "force_map", "coverage", "lifetime"}
    assert sorted(m.kind for m in campaign.mishaps) == [
        "duplicate",
        "missing_key",
        "truncated",
        "unmapped",
        "wrong_unit",
    ]
    assert [name for name, s in campaign.specimens.items() if "rig_constants" in s.effects] == ["PA-3"]
    assert 45 < campaign.rigs["shaker"].true.rig.clamp_omega / (2 * np.pi) < 60
    samples = sum(int(p.procedure.duration_s * s.sample_rate_hz) for p in campaign.planned for s in p.sensors.values())
    assert samples < 20e6
    # what the rig's file says is within two standard deviations of what is true
    for rig in campaign.rigs.values():
        for key in ("clamp_mass_kg", "load_cell_stiffness_n_per_mm"):
            sd = getattr(rig.stated, f"{key}_sd") or 0.0
            assert abs(getattr(rig.stated, key) - getattr(rig.true, key)) <= 2 * sd


def test_the_demonstration_tells_its_story() -> None:
    campaign = load_campaign("demo")
    assert {name: [*s.effects] for name, s in campaign.specimens.items() if s.effects} == {
        "PA-2": ["sensor_delay"],
        "PA-3": ["gain_error"],
        "SI-3": ["drive_lag"],
        "SI-4": ["leakage"],
        "SI-5": ["crosstalk"],
        "ST-1": ["amplitude_softening"],
        "ST-2": ["amplitude_softening"],
        "ST-3": ["clamp_slip"],
        "WR-1": ["wrinkling"],
    }
    assert "crosstalk" not in {*MECHANISMS, *FAULTS}, "nothing that dealab could name"
    assert {s.deviations.batch for s in campaign.specimens.values() if "amplitude_softening" in s.effects} == {"B7"}
    assert sorted((m.kind, m.recording) for m in campaign.mishaps) == [
        ("flipped", "SI-3-chirp-0.9mm"),
        ("mislabelled", "SI-2-chirp-0.45mm"),
        ("truncated", "PA-1-chirp-aborted"),
        ("unmapped", "PA-1-relaxation-export"),
        ("wrong_unit", "SI-3-relaxation"),
    ]
    clipped = simulate_one(campaign, next(p for p in campaign.planned if p.recording_id == "SI-6-chirp-0.6mm"))
    limit = campaign.rigs["shaker"].true.load_cell_range_n
    assert clipped.recording.channels["force"].values.max() > limit * (1 - 1e-4)
    changed = campaign.rigs["shaker-2"]
    assert changed.true.clamp_mass_kg > changed.stated.clamp_mass_kg + 5 * changed.stated.clamp_mass_kg_sd
    again = {(p.procedure.protocol, p.rig.name) for p in campaign.planned if p.night == 2}
    assert again == {("tap", "shaker-2")}, "nobody taps shaker-3: what is open there stays open"


@pytest.mark.parametrize(
    "recording_id", ["PA-3-chirp-0.7mm", "SI-1-chirp-1.8mm", "SI-1-sphs-7kV", "ST-1-cyclic-5Hz-0.5"]
)
def test_the_largest_loads_stay_within_the_channels_and_the_film_in_tension(recording_id: str) -> None:
    campaign = load_campaign("thesis")
    planned = next(p for p in campaign.planned if p.recording_id == recording_id)
    recording = simulate_one(campaign, planned).recording
    for quantity, channel in recording.channels.items():
        sensor = planned.sensors[quantity]
        assert channel.values.min() > sensor.low
        assert channel.values.max() < sensor.high - 2 * (sensor.resolution or 0)
    # the film's tension is the force without the inertia of the clamp
    rig = campaign.rigs[planned.rig.name].true.rig
    force = recording.channels["force"].values
    if planned.procedure.protocol != "cyclic":
        rate = 1e9 / float(np.diff(recording.channels["force"].time_ns[:2])[0])
        f = np.fft.rfftfreq(force.size, 1 / rate)
        omega = 2 * np.pi * f
        gain = 1 - rig.mass * omega**2 / rig.stiffness
        force = np.fft.irfft(np.where(f < 110, gain * np.fft.rfft(force), 0), force.size)
    assert force.min() > 0
