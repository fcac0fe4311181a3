"""The test files that installed packages bring, and those of a folder that `DEALAB_PEERS` names, as their peers read them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.strangers.peers import SKIPPED, WRONG, files_below, in_child, known_folders

FILES = files_below(list(known_folders().values()))


@pytest.mark.long_after(4)
@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_files_of_peers_are_read_as_their_peers_read_them(path: Path) -> None:
    verdict, what = in_child(path)
    if verdict == SKIPPED:
        pytest.skip(what)
    assert verdict != WRONG, what
