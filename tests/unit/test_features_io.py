"""Features go to text and come back."""

from __future__ import annotations

import base64
from dataclasses import fields, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from pipeline.diagnose.features.encode import pack, unpack
from pipeline.diagnose.features.kinds import KINDS, FeatureBlock, NoiseSample, RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.film import RelaxationModel
from schemas.metadata import RigConstants
from tests.helpers.truth_rig import make_session as true_session

WEIGHTS = ("re_data", "im_data")
finite = st.floats(-1e12, 1e12, allow_subnormal=False).map(lambda x: x if abs(x) > 1e-100 else 0.0)
anything = st.floats(allow_nan=True, allow_infinity=True)


def vectors(n: int, elements: st.SearchStrategy[float] = anything) -> st.SearchStrategy[Any]:
    return npst.arrays(np.float64, n, elements=elements)


@st.composite
def blocks(draw: st.DrawFn) -> FeatureBlock:
    n = draw(st.integers(1, 6))
    parts = draw(st.integers(1, 3))
    root = draw(npst.arrays(np.float64, (parts, n, n), elements=finite))
    basis = draw(st.sampled_from((root, root + root.transpose(0, 2, 1), root @ root.transpose(0, 2, 1))))
    if draw(st.booleans()):
        basis = draw(npst.arrays(np.float64, (parts, n), elements=finite))
    entries = draw(st.integers(0, 12))
    columns = np.array(draw(st.lists(st.integers(0, 2000), min_size=entries, max_size=entries)), dtype=float)
    support = {
        "re_data": draw(vectors(entries, finite)),
        "re_columns": columns,
        "re_rows": np.array([0.0, float(entries)]),
        "wave": draw(vectors(draw(st.integers(0, 5)))),
    }
    return FeatureBlock(
        kind=draw(st.sampled_from(KINDS)),
        label=draw(st.text(max_size=20)),
        value=draw(vectors(n)),
        components=tuple(f"force/{i}" for i in range(parts)),
        basis=basis,
        is_complex=draw(st.booleans()),
        frequency_hz=draw(vectors(n)),
        amplitude=draw(vectors(n)),
        voltage_kv=draw(vectors(n)),
        cycle=draw(vectors(n)),
        time_s=draw(vectors(n)),
        support=support,
    )


@st.composite
def features(draw: st.DrawFn) -> RecordingFeatures:
    setting = draw(st.tuples(st.floats(0, 1), st.floats(0, 1)))
    noise = NoiseSample("force", 0.001, draw(vectors(3)), draw(vectors(3)), draw(vectors(3)), setting)
    return RecordingFeatures(
        recording_id=draw(st.text(min_size=1, max_size=10)),
        specimen_id="S-1",
        protocol="chirp",
        loading="mechanical",
        started_at=datetime(2026, 3, 2, 8, tzinfo=UTC),
        duration_s=draw(st.floats(0, 1e6)),
        rig=RigConstants(rig_id="r", clamp_mass_kg=draw(st.floats(1e-6, 10)), noise_sd={"force": 1e-3}),
        blocks=tuple(draw(st.lists(blocks(), max_size=3))),
        noise=(noise,) * draw(st.integers(0, 2)),
        nodes=draw(vectors(4)),
        values=draw(st.dictionaries(st.text(max_size=8), st.floats(allow_nan=False, allow_infinity=False), max_size=3)),
        settings={"command": "recorded"},
        warnings=tuple(draw(st.lists(st.text(max_size=8), max_size=2))),
    )


def same(a: Any, b: Any, name: str = "") -> None:
    """Equal to the last bit, NaN included; weights as single precision has them, covariances within 1e-11 of their diagonals."""
    if name == "basis" and a.ndim == 3:
        assert a.shape == b.shape
        scale = np.sqrt(np.abs(np.einsum("cii->ci", a)))
        off = np.abs(a - b)
        assert np.all(off <= 1e-11 * scale[:, :, None] * scale[:, None, :])
        assert not np.einsum("cii->ci", off).any()
        assert np.array_equal(b, b.transpose(0, 2, 1)) == np.array_equal(a, a.transpose(0, 2, 1))
    elif isinstance(a, np.ndarray):
        if name in WEIGHTS:
            a = a.astype(np.float32).astype(np.float64)
        assert a.shape == b.shape
        assert b.flags.writeable
        np.testing.assert_array_equal(a.view(np.int64), b.view(np.int64))
    elif isinstance(a, FeatureBlock | NoiseSample | RecordingFeatures):
        for field in fields(a):
            same(getattr(a, field.name), getattr(b, field.name), field.name)
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            same(x, y)
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            same(a[key], b[key], key)
    else:
        assert a == b


@pytest.mark.slow
@given(features())
def test_features_come_back(given_features: RecordingFeatures) -> None:
    text = pack(given_features)
    found = unpack(text)
    same(given_features, found)
    same(found, unpack(pack(found)))


def test_weights_beyond_single_precision_are_kept_whole() -> None:
    block = FeatureBlock(
        KINDS[0], "sweep 1", np.ones(1), ("force/0",), np.ones((1, 1, 1)), False,
        *(np.full(1, np.nan) for _ in range(5)), {"re_data": np.array([1e300]), "re_columns": np.array([0.5])},
    )  # fmt: skip
    whole = RecordingFeatures(
        "r",
        "S-1",
        "chirp",
        "mechanical",
        datetime(2026, 3, 2, tzinfo=UTC),
        1.0,
        RigConstants(),
        (block,),
        (),
        np.ones(2),
    )
    found = unpack(pack(whole)).blocks[0].support
    assert found["re_data"][0] == 1e300
    assert found["re_columns"][0] == 0.5


@pytest.mark.parametrize(
    "text",
    ["", "%%%", base64.b64encode(b"no frame").decode(), base64.b64encode(zstandard.compress(b"\x02\0\0\0{}")).decode()],
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError):
        unpack(text)


def test_simulations_are_the_same_within_a_hundredth_of_the_noise() -> None:
    designs = (
        {"protocol": "chirp", "sweep_s": 3.0, "repeats": 1},
        {"protocol": "step", "loading": "electrical", "cycles": 2},
        {"protocol": "cyclic", "cycles": 4},
    )
    given_features = [reduce(r) for r in true_session(11, designs, material="silicone").recordings]
    packed = [pack(f) for f in given_features]
    assert sum(map(len, packed)) < 0.6 * sum(
        a.nbytes for f in given_features for b in f.blocks for a in (b.basis, *b.support.values())
    )
    direct, carried = make_session(given_features), make_session([unpack(text) for text in packed])
    model = direct.base_model(2)
    theta = model.theta(RelaxationModel(1.0, (1.5, 3.0), (0.03, 0.002)))
    difference = Simulation(direct).predict(model, theta) - Simulation(carried).predict(model, theta)
    assert np.abs(direct.whiten(difference)).max() < 0.01
    reordered = make_session([unpack(text) for text in reversed(packed)])
    assert [r.recording_id for r in reordered.recordings] == [r.recording_id for r in carried.recordings]
    assert replace(carried.recordings[0], blocks=()).rig == given_features[0].rig
