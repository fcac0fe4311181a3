"""Undoing a fault in the features of a recording: units, signs and delays of a channel act on them as factors.

Every feature is a linear functional of one channel, most of them over the size of the other. A factor on a channel is
therefore a factor on each kind of features, and on each part of their noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from pipeline.diagnose.features.blocks import add_unit_noise, operator_of, operator_support
from pipeline.diagnose.features.functionals import Operator
from pipeline.diagnose.features.kinds import (
    AMPLIFIER,
    CAPACITANCE,
    CHIRP_HARMONIC,
    CHIRP_LEVEL,
    CHIRP_RESPONSE,
    CLOCK,
    CYCLE_FORCE,
    CYCLIC_HARMONIC,
    CYCLIC_LEVEL,
    CYCLIC_RESPONSE,
    RELAXATION_FORCE,
    REST_HUM,
    REST_INPUT,
    SPHS_DETECTION,
    SPHS_RESPONSE,
    STEP_CAPACITANCE,
    STEP_FORCE,
    TAP_RING,
    UNDER_VOLTAGE,
    VOLTAGE_CHIRP_HARMONIC,
    VOLTAGE_CHIRP_RESPONSE,
    WEIGHT_GAIN,
    FeatureBlock,
    RecordingFeatures,
)
from pipeline.diagnose.features.observed import AMPLITUDE, FORCE_SWING, SEEN, VOLTAGE
from schemas.arrays import Complex, Float
from schemas.protocols import ELECTRICAL

RESPONSES = frozenset({CHIRP_RESPONSE, CYCLIC_RESPONSE}) | UNDER_VOLTAGE
"""Kinds of complex responses of the force, which a delay between the channels turns."""
_OF_OUTPUT = frozenset(
    {
        CHIRP_RESPONSE,
        CHIRP_HARMONIC,
        CHIRP_LEVEL,
        VOLTAGE_CHIRP_RESPONSE,
        VOLTAGE_CHIRP_HARMONIC,
        CYCLIC_RESPONSE,
        CYCLIC_HARMONIC,
        CYCLIC_LEVEL,
        STEP_FORCE,
        RELAXATION_FORCE,
        CYCLE_FORCE,
    }
)
"""Kinds of functionals of the force."""
_TIMES_KNOWN = 0.02
"""Share to which the time of a feature is known by which a drift is followed: a window sees each frequency at another time."""
_OF_OUTPUT_ALONE = (_OF_OUTPUT - RESPONSES) | {SPHS_DETECTION, STEP_CAPACITANCE}
"""Kinds that are not divided by the size of the input."""
_NO_UNIT = frozenset({REST_HUM, TAP_RING})
"""Kinds that are the same whatever the unit of the channels."""


def scale_channels(features: RecordingFeatures, factors: dict[str, float]) -> RecordingFeatures:
    """The features as they were had the samples of some channels been multiplied by factors.

    Parameters
    ----------
    factors : quantity → factor, negative for a sign

    Notes
    -----
    A response F/x scales with f/x of the factors, −F/V² with f/v². What is not divided by the recorded input (levels, windows,
    harmonics) scales with the output alone, and what its simulation takes of the input with the input. How strongly the noise of a
    displacement reaches the force goes with the response; about the resonance of the rig's file, which does not scale, that is near.
    """
    given = factors.get("displacement", 1.0)
    voltage = factors.get("voltage", 1.0)
    blocks = tuple(_scale_block(b, features.loading == ELECTRICAL, factors) for b in features.blocks)
    noise = tuple(
        replace(n, power=n.power * own**2, setting=(n.setting[0], n.setting[1] * abs(own)))
        for n in features.noise
        for own in [factors.get(n.quantity, 1.0)]
    )
    of_values = {
        "rest_force_n": factors.get("force", 1.0),
        FORCE_SWING: abs(factors.get("force", 1.0)),
        "capacitance_rest_pf": factors.get("capacitance", 1.0),
        REST_INPUT: given,
        "largest_strain": abs(given),
        SEEN + AMPLITUDE: abs(given),
        "largest_voltage_kv": abs(voltage),
        SEEN + VOLTAGE: abs(voltage),
        "exposure_kv2_s": voltage**2,
        "mean_squared_kv2": voltage**2,
    }
    values = {name: value * of_values.get(name, 1.0) for name, value in features.values.items()}
    return replace(features, blocks=blocks, noise=noise, values=values)


def _scale_block(block: FeatureBlock, electrical: bool, factors: dict[str, float]) -> FeatureBlock:
    given, voltage, command = (factors.get(name, 1.0) for name in ("displacement", "voltage", "command"))
    output = _scale_of_output(block.kind, factors)
    response = scale_of(block.kind, electrical, factors)
    scale = np.full(block.size, output if block.kind in _OF_OUTPUT_ALONE else response)
    if "order" in block.support and given < 0:
        # The phase of a harmonic is against as many times that of the input.
        scale = np.copysign(scale, np.resize(1 - 2 * (block.support["order"] % 2), block.size)) * np.sign(output)
    # What is simulated is a response times what the input was, and a drift of the output.
    by_name = {
        "piece_mm": given,
        "piece_kv": voltage,
        "piece_v": command,
        "profile_mm": abs(given),
        "input_mm": abs(given),
        "strain": given,
        "mean_strain": given,
        "level_kv": voltage,
        "wave": voltage,
        "command": command,
        "variance": factors.get("force", 1.0) ** 2,
    }
    support = {name: values * by_name.get(name, 1.0) for name, values in block.support.items()}
    for part in ("re", "im"):
        if f"{part}_data" in support:
            each = np.repeat(scale / response, np.diff(support[f"{part}_rows"]).astype(np.int64))
            support[f"{part}_data"] = support[f"{part}_data"] * each
    for name in ("drift_weight", "shift_weight"):
        if name in support and block.kind not in AMPLIFIER:
            support[name] = (support[name].reshape(block.size, -1) * (scale / output)[:, None]).ravel()
    own = [factors.get(_tell_channel(component), 1.0) for component in block.components]
    spread = np.outer(scale, scale) if block.basis.ndim == 3 else scale**2
    return replace(
        block,
        value=block.value * scale,
        basis=np.array([part * spread / f**2 for part, f in zip(block.basis, own, strict=True)]),
        amplitude=block.amplitude * abs(given),
        voltage_kv=block.voltage_kv * abs(voltage),
        support=support,
    )


def _tell_channel(component: str) -> str:
    """The channel whose noise a part of a block's noise is: mains are a part of the output's."""
    name = component.partition("/")[0]
    return "force" if name.startswith("mains") else name


def scale_of(kind: str, electrical: bool, factors: dict[str, float]) -> float:
    """Factor of the features of a kind."""
    if kind in _NO_UNIT:
        return 1.0
    if kind == WEIGHT_GAIN:
        return factors.get("force", 1.0)
    if electrical and kind in AMPLIFIER:
        return factors.get("voltage", 1.0) / factors.get("command", 1.0)
    given = factors.get("voltage", 1.0) ** 2 if electrical else factors.get("displacement", 1.0)
    return _scale_of_output(kind, factors) / given


def _scale_of_output(kind: str, factors: dict[str, float]) -> float:
    """Factor of the output that features of a kind are of."""
    return factors.get("capacitance" if kind in CAPACITANCE else "force", 1.0)


def turn(block: FeatureBlock, delay_s: float, drift: float) -> Complex:
    """Factors (n/2,) of a response where the output is stamped later by `delay_s`, and by `drift` of the time since the start."""
    half = block.size // 2
    late = delay_s + drift * block.time_s[:half]
    return np.asarray(np.exp(-2j * np.pi * block.frequency_hz[:half] * late))


def follow_delay(features: RecordingFeatures, delay_s: float, drift: float) -> RecordingFeatures:
    """The features with the knowledge that the output is stamped later by a delay and by a share of the time since the start.

    Functionals of the output take it into their weights at each frequency. Lines of a multisine are turned back; those
    that were not excited are left out, for a period that does not fit leaks into them.
    """
    followed = [follow_block(b, features.nodes, delay_s, drift) for b in features.blocks if b.kind != SPHS_DETECTION]
    return replace(features, blocks=tuple(followed))


def follow_block(block: FeatureBlock, nodes: Float, delay_s: float, drift: float) -> FeatureBlock:
    """The same of one block; what is no functional of the output stays."""
    if block.kind == SPHS_RESPONSE:
        return advance_block(block, delay_s, drift)
    if block.kind not in _OF_OUTPUT:
        return block
    operator = operator_of(block, nodes.size)
    late = delay_s + drift * np.nan_to_num(block.time_s)

    def turn_weights(weights: csr_array, part: Callable[[Float], Float]) -> csr_array:
        row = np.repeat(np.arange(block.size), np.diff(weights.indptr))
        turned_data = weights.data * part(-2 * np.pi * nodes[weights.indices] * late[row])
        return csr_array((turned_data, weights.indices, weights.indptr), shape=weights.shape)

    re = csr_array(turn_weights(operator.re, np.cos) + turn_weights(operator.im, np.sin))
    im = csr_array(turn_weights(operator.im, np.cos) - turn_weights(operator.re, np.sin))
    support = {**block.support, **operator_support(Operator(re, im))}
    uncertain = _TIMES_KNOWN * drift * np.nan_to_num(block.time_s)
    doubt = 2 * np.pi * np.nan_to_num(block.frequency_hz) * uncertain * _measure_size(block)
    return add_unit_noise(replace(block, support=support), doubt**2)


def _measure_size(block: FeatureBlock) -> Float:
    """(n,) size of each value, of both parts of a complex one together."""
    if not block.is_complex:
        return np.abs(block.value)
    half = block.size // 2
    return np.tile(np.hypot(block.value[:half], block.value[half:]), 2)


def advance_block(block: FeatureBlock, delay_s: float, drift: float) -> FeatureBlock:
    """A block of responses turned back as if its output had been stamped earlier; what is no response stays."""
    if block.kind not in RESPONSES:
        return block
    return replace(block, value=turned(block.value, 1 / turn(block, delay_s, drift)))


def turned(values: Float, factor: Complex) -> Float:
    """Real and imaginary parts (..., n) of complex numbers times factors (n/2,)."""
    half = values.shape[-1] // 2
    product = (values[..., :half] + 1j * values[..., half:]) * factor
    return np.concatenate([product.real, product.imag], axis=-1)


def _stretch_support(support: Mapping[str, Float], factor: float) -> dict[str, Float]:
    """What a block keeps for predictions, by the true clock: the names of times and frequencies have their unit in them."""
    found = dict(support)
    for name, values in support.items():
        if name.endswith("_s"):
            found[name] = values / factor
        elif name.endswith("_hz"):
            found[name] = values * factor
    if "piece" in support:
        found["piece"] = support["piece"] * [1.0, 1.0, 1 / factor, factor, factor]
        found[CLOCK] = support.get(CLOCK, np.ones(1)) * factor
    return found


def stretch_clock(features: RecordingFeatures, factor: float) -> RecordingFeatures:
    """The features had the clock of the recording claimed `factor` times less time than it does.

    Weights of samples stay as they are: what was claimed to be a frequency is `factor` times that, also in what a prediction over time
    needs.
    """
    blocks = tuple(
        replace(
            b,
            frequency_hz=b.frequency_hz * factor,
            time_s=b.time_s / factor,
            support=_stretch_support(b.support, factor),
        )
        for b in features.blocks
    )
    noise = tuple(
        replace(n, interval_s=n.interval_s / factor, frequency_hz=n.frequency_hz * factor) for n in features.noise
    )
    return replace(
        features, blocks=blocks, noise=noise, nodes=features.nodes * factor, duration_s=features.duration_s / factor
    )
