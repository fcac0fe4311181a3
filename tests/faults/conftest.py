"""What the tests of nights share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from pipeline.lab import snapshot
from tests.helpers.empty_database import open_copy


@pytest.fixture(scope="session", autouse=True)
def copied_databases() -> Iterator[None]:
    """The empty database of a new lab is made once: its thousand statements take as long as the rest of a small night."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(snapshot, "_make_empty", open_copy)
        yield
