"""What the tests of nights share."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from pipeline.lab import snapshot
from tests.helpers.empty_database import open_copy


@pytest.fixture(scope="session", autouse=True)
def heard_interrupts() -> Iterator[None]:
    """Ctrl-C is heard here and in the nights that are started: what runs behind a shell (`make test &`, `nohup`) has it ignored, and a
    test that interrupts itself would never end."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session", autouse=True)
def copied_databases() -> Iterator[None]:
    """The empty database of a new lab is made once: its thousand statements take as long as the rest of a small night."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(snapshot, "_make_empty", open_copy)
        yield
