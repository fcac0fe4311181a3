"""Errors as data: what went wrong, where, what was expected and what to do about it.

Every error that a user can cause is one of these. They pickle, so that a worker process can raise them, and they say
whether trying again could help. Programming errors are left to Python's own exceptions.
"""

from __future__ import annotations


def describe_error(error: Exception) -> str:
    """An error of the software itself with its place, for whoever mends it."""
    import traceback  # neither is needed until something has gone wrong
    from pathlib import Path

    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(place.filename).name}, line {place.lineno})"


class DealabError(Exception):
    """An error with its place and its remedy.

    Parameters
    ----------
    problem : what is wrong, with the value found, one sentence without a full stop at the end
    where : the file, recording, key or channel that is wrong; empty when there is no such place
    expected : what would have been right
    remedy : what the reader can do
    """

    transient = False

    def __init__(self, problem: str, *, where: str = "", expected: str = "", remedy: str = "") -> None:
        self.problem, self.where, self.expected, self.remedy = map(_encodable, (problem, where, expected, remedy))
        super().__init__(self.problem)

    @property
    def shortcoming(self) -> str:
        """What is wrong and what is needed, where the text around it names the place."""
        return f"{self.problem}; needed: {self.expected}" if self.expected else self.problem

    def as_dict(self) -> dict[str, str]:
        """The error as plain texts; `DealabError(**texts)` is it again."""
        return {"problem": self.problem, "where": self.where, "expected": self.expected, "remedy": self.remedy}

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.problem, self.where, self.expected, self.remedy)

    def __str__(self) -> str:
        text = f"{self.where}: {self.problem}" if self.where else self.problem
        if self.expected:
            text += f"; expected {self.expected}"
        if self.remedy:
            text += f"{'' if text.endswith('?') else '.'} {self.remedy}"
        return text


def _encodable(text: str) -> str:
    """The text with bytes of file names that are no UTF-8 as escapes, so that it can be stored and printed."""
    return text.encode("utf-8", "backslashreplace").decode()


def _rebuild(kind: type[DealabError], problem: str, where: str, expected: str, remedy: str) -> DealabError:
    return kind(problem, where=where, expected=expected, remedy=remedy)


class RefusedError(DealabError):
    """The content of a file cannot be used: it goes to quarantine with this reason."""


class MissingExtraError(RefusedError):
    """What reads this format or unit is not installed: the file is fine, and readable once it is."""

    transient = True


class UnmappedError(DealabError):
    """A data file of a foreign format without a mapping TOML: not a recording, reported as unmapped."""


class PendingError(DealabError):
    """A file that is still being written or changed while it was read: left alone, taken up next time."""

    transient = True


class AccidentError(DealabError):
    """Trouble of the machine, such as a folder without rights or a dead worker, that says nothing about the content: no
    verdict, tried again every night."""

    transient = True


class NotIdentifiableError(DealabError):
    """The data cannot carry the estimate that was asked for; the estimate is refused, the reason kept."""


class PremiseError(NotIdentifiableError):
    """The recording is not of the kind that its protocol says: no analysis of it as one tells anything, a diagnosis neither."""


class UsageError(DealabError):
    """A command was called with arguments that cannot be right (exit status 2)."""


class LabError(DealabError):
    """The lab folder, its lock or its database is not in the state that the command needs (exit status 1)."""
