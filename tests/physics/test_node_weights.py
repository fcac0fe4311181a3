"""Weights of nodes in dense blocks against the operators that they are made of."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.diagnose.features.functionals import Operator
from pipeline.diagnose.simulation.node_weights import NodeWeights, WeightsByState


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), nodes=st.integers(1, 400), operators=st.integers(1, 4))
def test_blocks_give_what_the_operators_give(seed: int, nodes: int, operators: int) -> None:
    """Rows that see everything, a few nodes, or none at all."""
    rng = np.random.default_rng(seed)

    def part(rows: int) -> scipy.sparse.csr_array:
        dense = rng.normal(size=(rows, nodes))
        first = rng.integers(0, nodes, rows)
        width = rng.choice([0, 1, 5, nodes], rows)
        at = np.arange(nodes)
        dense[(at < first[:, None]) | (at >= (first + width)[:, None])] = 0.0
        return scipy.sparse.csr_array(dense)

    sizes = rng.integers(1, 60, operators).tolist()
    made = [Operator(part(n), part(n)) for n in sizes]
    response = rng.normal(size=nodes) + 1j * rng.normal(size=nodes)
    found = NodeWeights(made).apply(response)
    np.testing.assert_allclose(found, np.concatenate([o.apply(response) for o in made]), rtol=1e-9, atol=1e-11)


def test_bands_are_not_multiplied_with_nodes_that_they_do_not_see() -> None:
    """Two bands apart, each seen by many rows: no block spans both."""
    nodes, rows = 2000, 50
    bands = np.zeros((2 * rows, nodes))
    bands[:rows, 100:120], bands[rows:, 1800:1830] = 1.0, 1.0
    part = scipy.sparse.csr_array(bands)
    weights = NodeWeights([Operator(part, part)])
    assert weights.read == 2 * rows * (20 + 30)


@pytest.mark.parametrize(("states", "rows"), [(60, 3), (3, 80)], ids=["many with few rows each", "few with many rows"])
def test_every_state_is_read_with_its_own_response(states: int, rows: int) -> None:
    """Some rows see nothing, and states differ in how many; at once or state by state, one response or several."""
    rng, nodes = np.random.default_rng(seed=1), 50
    made, of_state, first = [], [], 0
    for state in range(states):
        dense = rng.normal(size=(rows + state % 2, nodes)) * (rng.random((rows + state % 2, 1)) < 0.7)
        operator = Operator(scipy.sparse.csr_array(dense), scipy.sparse.csr_array(2 * dense))
        made.append(operator)
        of_state.append((first + np.arange(len(dense))[::-1], [operator]))
        first += len(dense)
    weights = WeightsByState(of_state)
    several = rng.normal(size=(4, states, nodes)) + 1j * rng.normal(size=(4, states, nodes))
    expected = [np.concatenate([o.apply(r)[::-1] for o, r in zip(made, response, strict=True)]) for response in several]
    np.testing.assert_allclose(weights.apply(several), expected, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(weights.apply(several[0]), expected[0], rtol=1e-9, atol=1e-11)
