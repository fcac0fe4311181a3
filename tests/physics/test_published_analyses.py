"""Numbers of published analyses of lifetimes, to the digits printed."""

from __future__ import annotations

import pytest

from tests.helpers.published_analyses import ANALYSES, Published

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("one", ANALYSES, ids=str)
def test_number_is_as_printed(one: Published) -> None:
    assert one.ours == one.printed, one.source


def test_there_are_at_least_ten_sources_of_data_and_no_number_twice() -> None:
    assert len({one.dataset.partition(",")[0] for one in ANALYSES}) >= 10
    assert len({str(one) for one in ANALYSES}) == len(ANALYSES)
