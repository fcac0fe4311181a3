"""How an error reads as one sentence after the other."""

from __future__ import annotations

from schemas.errors import UsageError


def test_a_question_is_not_followed_by_a_full_stop() -> None:
    told = str(UsageError("there is no x: did you mean X?", remedy="`dealab status` lists them"))
    assert told == "there is no x: did you mean X? `dealab status` lists them"
    assert str(UsageError("there is no x", remedy="Look")) == "there is no x. Look"
