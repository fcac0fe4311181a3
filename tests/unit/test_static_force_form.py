"""The search for a form of drift and slow part rests on derivatives that are written out."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.transform.static_force_form import Windows, build_design, differentiate_design

TIME = np.linspace(0.3, 29.7, 80)
WINDOWS = Windows(TIME, TIME, np.full(80, 0.37), 0.0, 30.0, ((8.0, 14.0), (19.0, 23.0)))


@given(
    late=st.floats(-3, 6),
    tau=st.floats(-2, 1.5),
    share=st.floats(-0.5, 0.5),
    linear=st.tuples(*[st.floats(-1, 1)] * 4),
    slow=st.booleans(),
)
def test_derivatives_of_the_model_are_those_of_small_steps(
    late: float, tau: float, share: float, linear: tuple[float, ...], slow: bool
) -> None:
    x, forces = np.array([late, tau, share] if slow else [late]), np.array(linear)
    steps = 1e-5 * np.eye(x.size)
    expected = [(build_design(WINDOWS, x + s) - build_design(WINDOWS, x - s)) @ forces / 2e-5 for s in steps]
    assert np.abs(differentiate_design(WINDOWS, x, forces) - np.column_stack(expected)).max() < 1e-7
