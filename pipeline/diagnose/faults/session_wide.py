"""Faults that many recordings share: what all of them state wrongly, a clock, the rig's file, a film that changed midway."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import softmax

from pipeline.diagnose.faults import fault as ids
from pipeline.diagnose.faults.agreement import LOUDEST, agrees, count_chi2, measure_left
from pipeline.diagnose.faults.correct import write
from pipeline.diagnose.faults.fault import Correction, Fault, say_times
from pipeline.diagnose.faults.fitted import Fitted, fit_session
from pipeline.diagnose.faults.levels import (
    DRIVE,
    RATE,
    REST_FORCE,
    STRAIN,
    Levels,
    name_clamp,
    read_density,
    read_sweeps,
)
from pipeline.diagnose.faults.undo import scale_channels, stretch_clock
from pipeline.diagnose.features.kinds import (
    CHIRP_RESPONSE,
    CYCLIC_RESPONSE,
    FILED_RING_HZ,
    REST_INPUT,
    RING_HZ,
    UNDER_VOLTAGE,
    WEIGHT_GAIN,
    RecordingFeatures,
)
from pipeline.diagnose.features.observed import AMPLITUDE, FORCE_SWING, SEEN, STATED
from pipeline.diagnose.mechanisms.actuation import FIELD_DEPENDENT_PERMITTIVITY
from pipeline.diagnose.mechanisms.rig import RIG_CONSTANTS
from pipeline.diagnose.mechanisms.sensor import GAIN_ERROR
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.plain_fit import PlainFit, measure_roughness
from pipeline.diagnose.simulation.session import Session, make_session
from pipeline.transform.calibration import GRAVITY_M_PER_S2
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.numbers import digits, significant
from schemas.protocols import ELECTRICAL, MECHANICAL

_ALIKE = 0.03
"""Difference of the logarithms of levels up to which recordings share one."""
_RIG_SLIPS = (10.0, 0.1, 1e3, 1e-3, 2.2046, 0.45359, 2.0, 0.5, 100.0, 0.01)
"""Written over true constants of a rig where a file says kg of g or lb, or a digit too many or too few."""
_FORCE_SLIPS = (
    1 / GRAVITY_M_PER_S2, GRAVITY_M_PER_S2, 1e3, 1e-3, 4.4482216, 1 / 4.4482216,
    2.0, 0.5, 10.0, 0.1, 2 * 2**0.5, 0.5 / 2**0.5,
)  # fmt: skip
"""Recorded over true force of all recordings."""
_SIZES = (("film_thickness_mm", 1.0, 0.5), ("film_width_mm", -1.0, 0.3), ("relative_permittivity", -1.0, 0.2))
"""Sizes that the actuation follows: power of the measured over the promised one, and how often each is the one that is wrong."""
_SIZE_SLIPS = (2.0, 0.5, 10.0, 0.1)
"""Slips of a size: of layers, halves and digits."""
_UNIT_SLIPS = (1e3, 1e3 / GRAVITY_M_PER_S2, 1e3 * GRAVITY_M_PER_S2)
"""Of forces in N beside such in mN, gf and kN, or kgf and mN, beside each other."""
_REST_ALIKE = 0.25
"""Logarithm by which the tension at rest differs within a session without another unit, for slips a hundred times as large."""
_LEAST_OF_RANGE = 2e-3
"""Share of a load cell's range below which nobody works on purpose: it is what its noise and its drift are."""
_TRAVEL_SLIPS = (1e3, 1e-3, 10.0, 0.1, 25.4, 1 / 25.4)
"""True over recorded displacement where that is in metres, micrometres, centimetres or inches and called millimetres."""
_VOLTAGE_SLIPS = (1e3, 1e-3, 100.0, 0.01, 10.0, 0.1, 2.0, 0.5)
"""True over recorded voltage where that is in volts, read at a monitor, or half of what is between peaks, and called kilovolts."""
_BELOW_RESONANCE = 0.25
"""Share of the lines of a multisine, the lowest, that are taken to lie below the resonance of the clamp."""
_NO_SLIP = "one of them is wrong by no usual slip, or the film or a gain makes the difference, which the recordings do not tell"
_WEAKENS = (FIELD_DEPENDENT_PERMITTIVITY.id, GAIN_ERROR.id)
"""Mechanisms that lower the actuation in all tests alike: by as much at every voltage, if these are alike."""
_WAYS = 2 * len(_RIG_SLIPS) + len(_FORCE_SLIPS) + 1
"""Ways in which a rig's file, or the unit or sign of all forces or displacements may be wrong."""
_FILED_SD, _ANYWHERE = 0.1, 10.0
"""Deviation of the logarithm of k/M from a slip's, which constants of a file have; range of that of another thing that was tapped."""
_WORTH_SAYING = 0.05
"""Probability from which a way to put a rig right is said."""
_TRIED = 5
"""Ways to put a rig right that are fitted, of those that make the film smoothest."""


def find_swapped_in_all(recordings: Sequence[RecordingFeatures]) -> Fault | None:
    """Channels that are swapped in all mechanical tests: what is called displacement rests at the tension that tests under voltage show, or
    what is called force rests at nothing and swings by the travel that the metadata state."""
    tests = [r for r in recordings if REST_INPUT in r.values]
    if len(tests) < 2:
        return None
    if _rests_at_tension(tests, recordings):
        words = "what is called displacement rests at the tension of the tests under voltage, in all mechanical tests"
    elif _swings_by_travel(tests):
        words = "what is called force rests at 0 and swings by as many N as the stated travel has mm, in all mechanical tests"
    else:
        return None
    names = tuple(r.recording_id for r in tests)
    both = ("force", "displacement"), ("displacement", "force")
    corrections = tuple(
        Correction(name, ids.CHANNELS_SWAPPED, f"columns.{a}.column", a, b, RULES.fault.named)
        for a, b in both
        for name in names
    )
    return Fault(ids.CHANNELS_SWAPPED, names, RULES.fault.named, words, corrections, sets_aside=False, bars=True)


def _rests_at_tension(tests: Sequence[RecordingFeatures], recordings: Sequence[RecordingFeatures]) -> bool:
    """Whether what is called displacement rests at the tension of the tests under voltage, and what is called force does not."""
    tension = np.array(
        [r.values["rest_force_n"] for r in recordings if r.loading == ELECTRICAL and "rest_force_n" in r.values]
    )
    spread = RULES.fault.rest_spread
    if tension.size < 2 or np.ptp(tension) > spread * abs(np.median(tension)):
        return False
    rest = np.median(tension)
    moved, force = (np.array([r.values[key] for r in tests]) / rest for key in (REST_INPUT, "rest_force_n"))
    return bool(np.abs(moved - 1).max() <= spread and np.abs(force - 1).min() >= 2 * spread)


def _swings_by_travel(tests: Sequence[RecordingFeatures]) -> bool:
    """Whether what is called force rests at nothing and swings by the travel that the metadata state, and what is called displacement does
    neither."""
    travel, swing, other = STATED + AMPLITUDE, FORCE_SWING, SEEN + AMPLITUDE
    stated = [r for r in tests if {travel, swing, other} <= set(r.values)]
    if len(stated) < 2:
        return False
    force, moved = (np.log([r.values[key] / r.values[travel] for r in stated]) for key in (swing, other))
    at_rest, tension = (
        np.abs([r.values[key] / r.values[swing] for r in stated]) for key in ("rest_force_n", REST_INPUT)
    )
    sd = RULES.fault.strain_sd
    return bool(
        np.abs(force).max() < sd
        and np.abs(moved).max() > RULES.fault.off * sd
        and at_rest.max() < sd
        and tension.min() > sd
    )


def find_contradicting_lengths(recordings: Sequence[RecordingFeatures]) -> Fault | None:
    """Lengths that contradict each other by a usual slip: the stretched one is the undeformed one times the pre-stretch."""
    keys = ("film_length_mm", "stretch_1", "total_length_mm")
    having = [r for r in recordings if all(STATED + key in r.values for key in keys)]
    if not having:
        return None
    ratio = np.array([np.prod([r.values[STATED + k] for k in keys[:2]]) / r.values[STATED + keys[2]] for r in having])
    off = [float(np.abs(np.log(ratio / slip)).max()) for slip in _SIZE_SLIPS]
    near = int(np.argmin(off))
    if off[near] > _ALIKE:
        return None
    slip = _SIZE_SLIPS[near]
    # Strains that are driven as the stretched length has them say that this is right.
    corrections = [
        Correction(r.recording_id, ids.SIZE_WRONG, key, write(now), write(now / factor), share)
        for key, factor, share in (
            ("film_length_mm", slip, 0.6),
            ("total_length_mm", 1 / slip, 0.2),
            ("stretch_1", slip, 0.2),
        )
        for r in having
        if (now := r.values[STATED + key])
    ]
    return Fault(
        ids.SIZE_WRONG,
        tuple(r.recording_id for r in having),
        RULES.fault.named,
        f"film_length_mm times stretch_1 is {significant(slip, 3)} times total_length_mm: one of them is wrong",
        tuple(corrections),
        sets_aside=False,
    )


def find_contradicting_units(recordings: Sequence[RecordingFeatures]) -> Fault | None:
    """Forces of some tests that are by a usual slip of a unit those of the others: at rest and in their noise.

    One test among several is judged by itself; of as many as the others, or of two, the range of the load cell says which are wrong, or
    nothing does.
    """
    tests = [r for r in recordings if r.values.get(REST_FORCE, 0.0) != 0]
    if len(tests) < 2:
        return None
    tests.sort(key=lambda r: abs(r.values[REST_FORCE]))
    rest = np.log([abs(r.values[REST_FORCE]) for r in tests])
    split = int(np.argmax(np.diff(rest))) + 1
    low, high = tests[:split], tests[split:]
    if min(len(low), len(high)) == 1 < max(len(low), len(high)):
        return None
    ratio = float(np.median(rest[split:]) - np.median(rest[:split]))
    noise = [[v for r in own if (v := read_density(r).get("force", 0.0)) > 0] for own in (low, high)]
    louder = 0.5 * float(np.log(np.median(noise[1]) / np.median(noise[0]))) if all(noise) else ratio
    slip, off = _find_nearest(ratio, _UNIT_SLIPS)
    spread = max(float(np.ptp(part)) for part in (rest[:split], rest[split:]))
    # Noise that is nearer to that of the others than to theirs in another unit is of the same unit.
    if max(off, spread) > _REST_ALIKE or 2 * louder < np.log(slip):
        return None
    low_is_wrong = _judge_range(low, high)
    ways = ((low, slip, low_is_wrong), (high, 1 / slip, 1 - low_is_wrong))
    wrong, factor, share = max(ways, key=lambda way: (way[2], -len(way[0])))
    corrections = tuple(
        Correction(r.recording_id, ids.UNIT_SLIP, "columns.force.scale", "1", write(times), probability)
        for own, times, probability in sorted(ways, key=lambda way: -way[2])
        for r in own
    )
    words = f"the force of {_list_names(low)} is {significant(slip, 3)} times as small as that of {_list_names(high)}, at rest as in its noise"
    certain = (
        f"{words}: it is recorded {say_times(1 / factor)}"
        if share > 1 / 2
        else f"{words}: either may be in another unit"
    )
    names = tuple(r.recording_id for r in recordings if r in wrong)
    return Fault(ids.UNIT_SLIP, names, RULES.fault.named, certain, corrections, sets_aside=False, bars=True)


def _judge_range(low: Sequence[RecordingFeatures], high: Sequence[RecordingFeatures]) -> float:
    """Probability that the smaller forces of two groups are the wrong ones, by the range of the load cell."""
    ranges = [n for r in (*low, *high) if (n := r.rig.load_cell_range_n)]
    if not ranges:
        return 0.5
    smallest, largest = (
        max(abs(r.values[REST_FORCE]) + r.values.get(FORCE_SWING, 0.0) for r in own) / float(np.median(ranges))
        for own in (low, high)
    )
    if largest > 1:
        return 1 - RULES.fault.named
    return RULES.fault.named if smallest < _LEAST_OF_RANGE else 0.5


def _list_names(recordings: Sequence[RecordingFeatures]) -> str:
    return ", ".join(r.recording_id for r in recordings)


def find_stated_by_all(
    recordings: Sequence[RecordingFeatures], levels: Mapping[str, Levels]
) -> tuple[list[RecordingFeatures], list[Fault]]:
    """What the metadata of all mechanical tests state otherwise than their samples show, with the recordings put right."""
    found: list[Fault] = []
    tests = [r for r in recordings if r.loading == MECHANICAL]
    stated, strain = _share(tests, levels, STRAIN)
    put_right = list(recordings)
    if strain is not None:
        scaled = _scale_travel(tests, float(np.exp(-strain)))
        found.append(_fault_of_strain(stated, -strain) if scaled is None else scaled[0])
        right = {} if scaled is None else {r.recording_id: r for r in scaled[1]}
        put_right = [right.get(r.recording_id, r) for r in recordings]
    clocks = _share_clock(recordings, levels)
    if clocks is not None:
        words, slow, rate = clocks
        stretch, late = float(np.exp(-rate)), {r.recording_id for r in slow}
        put_right = [stretch_clock(r, stretch) if r.recording_id in late else r for r in put_right]
        found.append(
            Fault(
                ids.SAMPLE_RATE_WRONG,
                tuple(r.recording_id for r in slow),
                RULES.fault.named,
                f"the clocks of all {words}tests claim {significant(stretch, 4)} times the time that passed",
                tuple(
                    Correction(r.recording_id, ids.SAMPLE_RATE_WRONG, "time.scale", "1", write(1 / stretch), RULES.fault.named)
                    for r in slow
                ),
                sets_aside=False,
            )
        )  # fmt: skip
    driven, drive = _share([r for r in recordings if r.loading == ELECTRICAL], levels, DRIVE)
    if drive is not None:
        scaled = _scale_voltage(driven, float(np.exp(-drive)))
        found.append(_fault_of_drive(driven, float(np.exp(drive))) if scaled is None else scaled[0])
        right = {} if scaled is None else {r.recording_id: r for r in scaled[1]}
        put_right = [right.get(r.recording_id, r) for r in put_right]
    return put_right, found


def _scale_travel(tests: Sequence[RecordingFeatures], factor: float) -> tuple[Fault, list[RecordingFeatures]] | None:
    """The unit of all displacements, which makes them `factor` times too small, with the tests put right; None where the unit is not
    what is wrong.

    Strains or lengths that are stated wrongly leave the responses those of a film on its clamp; another unit of the displacement does not.
    """
    slip, off = _find_nearest(float(np.log(factor)), _TRAVEL_SLIPS)
    if off > _ALIKE:
        return None
    put_right = [scale_channels(r, {"displacement": slip}) for r in tests]
    try:
        as_it_is, scaled = (measure_roughness(make_session(own)) for own in (tests, put_right))
    except NotIdentifiableError:
        return None
    if scaled > RULES.fault.smoother * as_it_is:
        return None
    return _fault_of_unit(
        tests, "displacement", slip, "it is what strain_pp says, and the film moves its clamp as such a film does"
    ), put_right


def _scale_voltage(tests: Sequence[RecordingFeatures], factor: float) -> tuple[Fault, list[RecordingFeatures]] | None:
    """The unit of all voltages, which makes them `factor` times too small, with the tests put right; None where the unit is not what is
    wrong, or nothing tells.

    A drive_kv that is stated wrongly leaves the film as strong as its sizes promise; another unit of the voltage does not.
    """
    slip, off = _find_nearest(float(np.log(factor)), _VOLTAGE_SLIPS)
    acts = [a for r in tests if (a := _measure_actuation(r)) is not None]
    if off > _ALIKE or not acts:
        return None
    stronger = float(np.median(acts))
    if abs(stronger - 2 * np.log(slip)) > abs(np.log(slip)):
        return None  # nearer to what the sizes promise as it is
    put_right = [scale_channels(r, {"voltage": slip}) for r in tests]
    return _fault_of_unit(
        tests, "voltage", slip, "it is what drive_kv says, and the film acts as its sizes promise"
    ), put_right


def _measure_actuation(recording: RecordingFeatures) -> float | None:
    """ln of the force per squared voltage below the resonance over what the sizes of the film promise; None where either is not known."""
    promised = recording.values.get("actuation_n_per_kv2")
    sizes = []
    for block in recording.blocks:
        if block.kind in UNDER_VOLTAGE:
            half = block.size // 2
            low = block.frequency_hz[:half] <= np.quantile(block.frequency_hz[:half], _BELOW_RESONANCE)
            sizes.append(np.median(np.hypot(block.value[:half], block.value[half:])[low]))
    size = float(np.median(sizes)) if sizes else 0.0
    return None if promised is None or not size > 0 else float(np.log(size / promised))


def _fault_of_unit(tests: Sequence[RecordingFeatures], channel: str, slip: float, words: str) -> Fault:
    """The fault of a channel that all tests record in another unit, by which it is `slip` times too small.

    The noise of the features was made with that unit, so that nothing else can be asked before it is put right.
    """
    probability = RULES.fault.named
    return Fault(
        ids.UNIT_SLIP,
        tuple(r.recording_id for r in tests),
        probability,
        f"the {channel} of all tests is recorded {say_times(1 / slip)}: with its unit right {words}",
        tuple(
            Correction(r.recording_id, ids.UNIT_SLIP, f"columns.{channel}.scale", "1", write(slip), probability)
            for r in tests
        ),
        sets_aside=False,
        bars=True,
    )


def _fault_of_drive(tests: Sequence[RecordingFeatures], factor: float) -> Fault:
    """Voltages of all tests that are a common factor off what drive_kv says: either may be wrong."""
    return Fault(
        ids.UNIT_SLIP,
        tuple(r.recording_id for r in tests),
        0.5,
        f"the voltage is {significant(factor, 3)} times what drive_kv says in all tests",
        tuple(
            Correction(r.recording_id, ids.UNIT_SLIP, "columns.voltage.scale", "1", write(1 / factor), 0.5)
            for r in tests
        ),
        sets_aside=False,
    )


def _share_clock(
    recordings: Sequence[RecordingFeatures], levels: Mapping[str, Levels]
) -> tuple[str, list[RecordingFeatures], float] | None:
    """The tests whose clock is off by a common factor, in words and as a list, with the logarithm of the frequencies seen over those
    stated: all tests, or those of one loading; None where there is no such clock.

    Sweeps tell their highest frequency less well than sinusoids and periods tell theirs: they only say whether they share it.
    """
    tests = [r for r in recordings if r.loading in (MECHANICAL, ELECTRICAL)]
    turning = [r for r in tests if r.protocol != "chirp"]
    for words, loadings in (
        ("", {MECHANICAL, ELECTRICAL}),
        ("mechanical ", {MECHANICAL}),
        ("electrical ", {ELECTRICAL}),
    ):
        own = [r for r in tests if r.loading in loadings]
        shown, rate = _share([r for r in turning if r.loading in loadings], levels, RATE)
        if rate is None:
            continue
        silent = {r.loading for r in own} - {r.loading for r in shown}
        swept = read_sweeps([r for r in own if r.loading in silent])
        if not silent or (swept is not None and abs(swept - rate) < abs(swept)):
            return words, own, rate
    return None


def _share(
    recordings: Sequence[RecordingFeatures], levels: Mapping[str, Levels], name: str
) -> tuple[list[RecordingFeatures], float | None]:
    """Recordings that have a level, and the one that all of them share far from what is expected; None where they do not."""
    having = [r for r in recordings if name in levels[r.recording_id].by_name]
    values = np.array([levels[r.recording_id].by_name[name].value for r in having])
    if len(having) < 2:
        return having, None
    middle = float(np.median(values))
    far = min(levels[r.recording_id].by_name[name].z() for r in having) > RULES.fault.suspect
    return having, middle if far and np.abs(values - middle).max() < max(_ALIKE, 0.1 * abs(middle)) else None


def _fault_of_strain(recordings: Sequence[RecordingFeatures], stated: float) -> Fault:
    """Strains of all recordings that are stated by a common factor wrong, ln of it: the strains or the length they refer to."""
    factor = float(np.exp(stated))
    amplitude_for_pp = abs(abs(stated) - np.log(2)) < 2 * _ALIKE
    share = 0.6 if amplitude_for_pp else 0.2
    corrections = []
    for r in recordings:
        strain = r.values[STATED + AMPLITUDE] / r.values["strain_length_mm"]
        now, then = write(strain), write(strain / factor)
        corrections.append(Correction(r.recording_id, ids.STRAIN_WRONG, "strain_pp", now, then, share))
        for key in ("film_length_mm", "total_length_mm"):
            length = r.values.get(STATED + key)
            if length is not None:
                now, then = write(length), write(length / factor)
                corrections.append(Correction(r.recording_id, ids.SIZE_WRONG, key, now, then, 1 - share))
    return Fault(
        ids.STRAIN_WRONG if share > 0.5 else ids.SIZE_WRONG,
        tuple(r.recording_id for r in recordings),
        max(share, 1 - share),
        f"strain_pp times the length says {significant(factor, 3)} times the travel that was driven in all tests:"
        " either the strains or the length is wrong, which of them the recordings do not tell",
        tuple(corrections),
        sets_aside=False,
    )


@dataclass(frozen=True)
class _Remedy:
    """A way to put all recordings right: the fault, the key, written over true value, and how."""

    cause: str
    key: str
    factor: float
    words: str
    apply: Callable[[RecordingFeatures], RecordingFeatures]

    def correct(self, recording: RecordingFeatures) -> tuple[str, str]:
        """Value now, and proposed."""
        if self.key.startswith("rig."):
            now = getattr(recording.rig, self.key.removeprefix("rig."))
            return write(now), write(now / self.factor)
        return "1", write(1 / self.factor)


def _list_remedies(session: Session) -> Iterator[_Remedy]:
    for key, words in (("clamp_mass_kg", "clamp mass"), ("load_cell_stiffness_n_per_mm", "load cell's stiffness")):
        if all(getattr(r.rig, key) for r in session.recordings):
            for factor in _RIG_SLIPS:
                yield _Remedy(
                    RIG_CONSTANTS.id, f"rig.{key}", factor,
                    f"the {words} in the rig's file is {significant(factor, 4)} times that of the rig",
                    partial(_correct_rig, key, factor),
                )  # fmt: skip
    tension = [r.values["rest_force_n"] for r in session.recordings if "rest_force_n" in r.values]
    middle = float(np.median(tension)) if tension else 0.0
    if tension and np.median(np.abs(np.array(tension) - middle)) < RULES.fault.rest_spread * abs(middle):
        # A film pulls: the tension at rest says which of the two has the opposite sign, where the load cells are not zeroed under it.
        channel = "force" if middle < 0 else "displacement"
        yield _Remedy(
            ids.SIGN_FLIPPED, f"columns.{channel}.scale", -1.0, f"the {channel} of all tests has the opposite sign",
            partial(scale_channels, factors={channel: -1.0}),
        )  # fmt: skip
    for factor in _FORCE_SLIPS:
        yield _Remedy(
            ids.UNIT_SLIP, "columns.force.scale", factor, f"the force of all tests is recorded {say_times(factor)}",
            partial(scale_channels, factors={"force": 1 / factor}),
        )  # fmt: skip


def _correct_rig(key: str, factor: float, recording: RecordingFeatures) -> RecordingFeatures:
    return replace(recording, rig=_change_rig(recording.rig, key, factor))


def _change_rig(rig: RigConstants, key: str, factor: float) -> RigConstants:
    """The rig with one constant, and its error, divided by a factor."""
    value, sd = getattr(rig, key), getattr(rig, f"{key}_sd")
    changed = {key: value / factor} | ({} if sd is None else {f"{key}_sd": sd / factor})
    return replace(rig, **changed)


def is_off(session: Session, plain: PlainFit) -> bool:
    """Whether a plain fit misses the recordings, or the rig's file."""
    left = measure_left(session, count_chi2(session, plain.misfit))
    return left > RULES.fault.agrees or _find_furthest(plain) > RULES.fault.off


def _find_furthest(plain: PlainFit) -> float:
    """Deviation of the rig's constants from their file, in standard deviations, the largest."""
    model = plain.model
    own = [i for i, name in enumerate(model.names) if name.startswith("rig ") and "damping" not in name]
    return max((abs(float(plain.theta[i] - model.prior_mean[i]) / float(model.prior_sd[i])) for i in own), default=0.0)


def _rank_remedies(session: Session) -> list[tuple[float, _Remedy]]:
    """Remedies that make the responses much more like those of a film, the smoothest first, each with what is left of their roughness.

    The unit of the forces that the weights weigh is among them, whatever the responses say: those of a heavy film below the resonance of a
    clamp are those of a film in any unit. None where there is no response.
    """
    weighed = _read_weights(session)
    try:
        as_it_is = measure_roughness(session)
    except NotIdentifiableError:
        return []
    found = []
    for number, remedy in enumerate(_list_remedies(session)):
        if remedy.key.startswith("rig."):
            own = remedy.key.removeprefix("rig.")
            changed = replace(session, rigs=tuple(_change_rig(rig, own, remedy.factor) for rig in session.rigs))
        else:
            changed = make_session([remedy.apply(r) for r in session.recordings], session.laws)
        try:
            found.append((measure_roughness(changed), number, remedy))
        except (NotIdentifiableError, ValueError):
            continue  # no film at all fits such a rig
    found.sort(key=lambda item: item[:2])
    return [
        (left / as_it_is, remedy)
        for left, _, remedy in found
        if left < RULES.fault.smoother * as_it_is or (remedy.cause == ids.UNIT_SLIP and remedy.factor == weighed)
    ]


def _read_weights(session: Session) -> float | None:
    """The usual slip of a force's unit by which known weights are read wrong; None where there are no weights, or they tell none."""
    gains = [float(p.block.value[0]) for p in session.places if p.block.kind == WEIGHT_GAIN]
    if not gains or min(gains) <= 0:
        return None
    read = np.log(gains)
    nearest, off = _find_nearest(float(np.median(read)), _FORCE_SLIPS)
    return nearest if off < _ALIKE and np.ptp(read) < _ALIKE else None


def find_wrong_file(
    recordings: Sequence[RecordingFeatures], fitted: Fitted, without: Collection[str]
) -> tuple[list[RecordingFeatures], Fitted, Fault] | None:
    """What is wrong with the rig's file or the unit of all forces: the recordings put right, their fit, and the fault.

    Parameters
    ----------
    recordings : of the session
    fitted : those of them that are not in `without`

    Returns
    -------
    None where no correction brings all recordings together with the file
    """
    session, _, plain = fitted
    rough = _rank_remedies(session) if is_off(session, plain) else []
    if not rough:
        return None
    before = _count_whole(fitted)
    tried = [_apply_remedy(remedy, recordings, without) for _, remedy in rough[:_TRIED]]
    best = min(tried, key=lambda t: t.chi2)
    if not agrees(measure_left(best.fitted[0], best.chi2), measure_left(session, before)):
        fault = _blame_file(session, rough)
        return None if fault is None else (list(recordings), fitted, fault)
    fitting = [t for t in tried if _find_furthest(t.fitted[2]) <= RULES.fault.off]
    log = np.array([0.0, *(0.5 * (before - t.chi2) + np.log(RULES.fault.prior / _WAYS) for t in fitting)])
    share = softmax(log)
    if share[0] > 1 - RULES.fault.named:
        return None
    likely = sorted(
        ((float(p), t) for p, t in zip(share[1:], fitting, strict=True) if p > _WORTH_SAYING),
        key=lambda pair: -pair[0],
    )
    best = likely[0][1]
    cause = best.remedy.cause
    corrections = tuple(
        Correction(r.recording_id, t.remedy.cause, t.remedy.key, *t.remedy.correct(r), p)
        for p, t in likely
        for r in recordings
    )
    fault = Fault(
        cause,
        tuple(r.recording_id for r in recordings),
        float(sum(p for p, t in zip(share[1:], fitting, strict=True) if t.remedy.cause == cause)),
        best.remedy.words
        + (f" (or {digits(len(likely) - 1, 'other way')} among the corrections)" if len(likely) > 1 else ""),
        corrections,
        False,
        measure_left(best.fitted[0], count_chi2(best.fitted[0], best.fitted[2].misfit)),
    )
    return best.recordings, best.fitted, fault


@dataclass(frozen=True)
class _Tried:
    """A remedy with the recordings as it puts them right, their fit, and its χ² with what deviates from the rig's file."""

    remedy: _Remedy
    recordings: list[RecordingFeatures]
    fitted: Fitted
    chi2: float


def _apply_remedy(remedy: _Remedy, recordings: Sequence[RecordingFeatures], without: Collection[str]) -> _Tried:
    """A remedy of a session, fitted without some recordings."""
    changed = [remedy.apply(r) for r in recordings]
    fitted = fit_session([r for r in changed if r.recording_id not in without])
    return _Tried(remedy, changed, fitted, _count_whole(fitted))


def _count_whole(fitted: Fitted) -> float:
    """χ² of a fit with what deviates from the rig's file, without the amplifier's share."""
    session, _, plain = fitted
    return count_chi2(session, plain.solution.residual)


def _blame_file(session: Session, ranked: Sequence[tuple[float, _Remedy]]) -> Fault | None:
    """The rig's file, where the responses are those of a film with another one only.

    The features themselves were made with the file: their noise and what is simulated for them are wrong with it, so that no
    fit of them can tell. Voltages alone do not tell: how strongly they act is not known well enough.
    """
    rules, recordings = RULES.fault, session.recordings
    if _count_responses(session) < rules.film_points:
        return None
    of_file = [(left, r) for left, r in ranked if r.cause == RIG_CONSTANTS.id]
    if not of_file or of_file[0][0] > rules.film_like:
        return None
    log = np.array([-rules.film_points * np.log(left) for left, _ in ranked])
    share = softmax(log)
    probability = float(share[[r.cause == RIG_CONSTANTS.id for _, r in ranked]].sum())
    if probability < rules.named:
        return None
    likely = [(float(p), r) for p, (_, r) in zip(share, ranked, strict=True) if p > _WORTH_SAYING]
    corrections = tuple(
        Correction(own.recording_id, r.cause, r.key, *r.correct(own), p) for p, r in likely for own in recordings
    )
    words = " or ".join(r.words for _, r in likely)
    names = tuple(r.recording_id for r in recordings)
    return Fault(RIG_CONSTANTS.id, names, probability, words, corrections, sets_aside=False, bars=True)


def judge_taps(
    taps: Sequence[RecordingFeatures], recordings: Sequence[RecordingFeatures], fitted: Fitted
) -> Fault | None:
    """What taps say that ring far from the clamp of their rig's file: the file is wrong, or something else was tapped.

    Parameters
    ----------
    taps : those that contradict the file
    recordings, fitted : the others, and their fit with the file as it is
    """
    if not taps:
        return None
    session, _, plain = fitted
    ring, filed = (float(np.median([t.values[key] for t in taps])) for key in (RING_HZ, FILED_RING_HZ))
    words = f"what was tapped rings at {significant(ring, 4)} Hz, the clamp of the rig's file would at {significant(filed, 4)} Hz"
    if _count_responses(session) >= RULES.fault.film_points and not is_off(session, plain):
        # The film's responses have the clamp of the file on them.
        names = tuple(t.recording_id for t in taps)
        return Fault(ids.FOREIGN_RIG, names, RULES.fault.named, f"{words}, and the tests agree with the file")
    log_ratio = 2 * float(np.log(ring / filed))
    nearest, off = _find_nearest(log_ratio, _RIG_SLIPS)
    # ω² = k/M: too heavy and too soft look alike. A slip is one of a few factors, another thing that was tapped may ring anywhere.
    slip = float(np.exp(-0.5 * (off / _FILED_SD) ** 2)) / (np.sqrt(2 * np.pi) * _FILED_SD * len(_RIG_SLIPS))
    probability = slip / (slip + 1 / _ANYWHERE)
    factor = nearest if probability > 0.5 else float(np.exp(log_ratio))
    own = [r for r in recordings if name_clamp(r.rig) == name_clamp(taps[0].rig)]
    corrections = tuple(
        Correction(r.recording_id, RIG_CONSTANTS.id, f"rig.{key}", write(now), write(now / off_by), 0.5 * probability)
        for key, off_by in (("clamp_mass_kg", factor), ("load_cell_stiffness_n_per_mm", 1 / factor))
        for r in (*taps, *own)
        if (now := getattr(r.rig, key))
    )
    names = tuple(r.recording_id for r in (*taps, *own))
    return Fault(RIG_CONSTANTS.id, names, probability, words, corrections, sets_aside=False, bars=True)


def _count_responses(session: Session) -> int:
    """Complex values that mechanical tests say of film and clamp."""
    return sum(p.block.size // 2 for p in session.places if p.block.kind in (CHIRP_RESPONSE, CYCLIC_RESPONSE))


def _round_off(log_factor: float, sd: float) -> float:
    """The usual slip that a factor, known by its logarithm, may be; the factor itself where it is none."""
    nearest, off = _find_nearest(log_factor, _SIZE_SLIPS)
    return nearest if off < 2 * sd else float(np.exp(log_factor))


def _find_nearest(log_factor: float, slips: Sequence[float]) -> tuple[float, float]:
    """The usual slip nearest to a factor, known by its logarithm, and the difference of their logarithms."""
    off = [abs(log_factor - float(np.log(slip))) for slip in slips]
    near = int(np.argmin(off))
    return slips[near], off[near]


def merge_lengths(faults: Sequence[Fault]) -> list[Fault]:
    """Faults with one of the length where strains and actuation are off by the same factor: a wrong length does both at once."""
    strains = [f for f in faults if any(c.key == "total_length_mm" for c in f.corrections)]
    sizes = [f for f in faults if any(c.key == "film_thickness_mm" for c in f.corrections)]
    if not strains or not sizes:
        return list(faults)
    ratios = []
    for fault, key in ((strains[0], "total_length_mm"), (sizes[0], "film_thickness_mm")):
        c = next(c for c in fault.corrections if c.key == key)
        ratios.append(float(np.log(float(c.value_now) / float(c.value_proposed))))
    if abs(ratios[0] - ratios[1]) > RULES.features.permittivity_sd:
        return list(faults)
    lengths = tuple(
        replace(c, probability=RULES.fault.named) for c in strains[0].corrections if c.cause == ids.SIZE_WRONG
    )
    merged = replace(
        strains[0],
        cause=ids.SIZE_WRONG,
        probability=RULES.fault.named,
        corrections=lengths,
        finding=f"the length is {say_times(float(np.exp(ratios[0])))}: strains and actuation are off by that alike",
    )
    return [merged, *(f for f in faults if f not in (strains[0], sizes[0]))]


def find_wrong_sizes(fitted: Fitted) -> Fault | None:
    """The actuation against what thickness, width and permittivity promise: they show in nothing else."""
    session, _, plain = fitted
    place = plain.model.index("log actuation")
    if place is None or measure_left(session, count_chi2(session, plain.misfit)) > LOUDEST:
        return None
    sd = float(plain.model.prior_sd[place])
    ratio = float(plain.theta[place] - plain.model.prior_mean[place])
    believed = plain.model.free_actuation(plain.theta, RULES.fault.off)
    if not np.isfinite(sd) or np.isfinite(believed.prior_sd[place]):
        return None
    electrical = [r for r in session.recordings if r.loading == "electrical"]
    factor = _round_off(ratio, sd)
    is_slip = factor in _SIZE_SLIPS
    corrections = []
    for r in electrical:
        for key, power, share in _SIZES:
            now = r.values.get(STATED + key)
            if now is not None:
                then = now * factor ** (-power)
                corrections.append(Correction(r.recording_id, ids.SIZE_WRONG, key, write(now), f"{then:.3g}", share))
    return Fault(
        ids.SIZE_WRONG,
        tuple(r.recording_id for r in electrical),
        RULES.fault.named if is_slip else RULES.fault.no_slip,
        f"the voltage acts {significant(np.exp(ratio), 2)} times as strongly as thickness, width and permittivity promise: "
        + ("one of them is wrong, which of them the recordings do not tell" if is_slip else _NO_SLIP),
        tuple(corrections),
        sets_aside=False,
        alike=() if is_slip else (_WEAKENS if ratio < 0 else (GAIN_ERROR.id,)),
    )
