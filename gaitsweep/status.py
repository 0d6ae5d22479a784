"""The result codes of rows, and of sets of constants: how they ended, and what that means for their gait."""

from __future__ import annotations

import enum
import functools
from typing import TYPE_CHECKING, Self

import numpy as np
from jaxtyping import Bool

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike

__all__ = ["RECURRENT", "Outcome", "ResultCode", "SetStatus", "Status", "StatusNames", "Verdict"]


class Verdict(enum.Enum):
    """The class of a status: the row is complete, undecided, or failed."""

    sound = "sound"  # the row reached the end that its run asked for
    undecided = "undecided"  # a limit ended the row: with a larger limit its result is still open
    failed = "failed"  # the body fell or the integration failed: the row has no final gait


class ResultCode(enum.IntEnum):
    """The base of result codes: a number, a sentence, and a verdict, by default undecided."""

    sentence: str
    verdict: Verdict

    def __new__(cls, number: int, sentence: str, verdict: Verdict = Verdict.undecided) -> Self:
        code = int.__new__(cls, number)
        code._value_ = number
        code.sentence = sentence
        code.verdict = verdict
        return code


class StatusNames(frozenset[str]):
    """The names of some statuses, as a table's column `status` has them."""

    def among(self, values: ArrayLike) -> Bool[np.ndarray, " *rows"]:
        """Test for each of some statuses (n,), names or the engine's numbers, whether it is one of these."""
        if (categories := getattr(getattr(values, "dtype", None), "categories", None)) is not None:
            import pandas as pd

            return _known(self, tuple(categories))[pd.Categorical(values).codes]
        statuses = np.asarray(values)
        if statuses.dtype.kind in "iu":
            # several times as fast as `np.isin`; other numbers are clipped to the ends, which are false
            return _by_number(self).take(statuses + 1, mode="clip")
        if statuses.dtype.kind == "f":
            return np.isin(statuses, [Status[name] for name in self])
        if statuses.dtype.kind == "O":  # which may have `pd.NA`, that NumPy cannot compare
            import pandas as pd  # only columns of tables come here

            statuses = np.where(pd.isna(statuses), "", statuses)
        return np.isin(statuses, list(self))


# cached, since to compare names takes longer than to look up the rows of a small table
@functools.lru_cache(maxsize=256)
def _known(names: StatusNames, categories: tuple[object, ...]) -> Bool[np.ndarray, " categories"]:
    """Whether each category is one of the names, and false for a missing one, whose code is -1."""
    return np.append(names.among(np.asarray(categories)), False)


@functools.cache
def _by_number(names: StatusNames) -> Bool[np.ndarray, " numbers"]:
    """Whether the status with the number before each place is one of the names."""
    return np.isin(np.arange(-1, max(Status) + 2), [Status[name] for name in names])


class _StatusesWith:
    """The names of all statuses with one verdict; an attribute of `Status`."""

    def __init__(self, verdict: Verdict) -> None:
        self._verdict = verdict

    def __get__(self, _: Status | None, statuses: type[Status]) -> StatusNames:
        return StatusNames(status.name for status in statuses if status.verdict is self._verdict)


class Status(ResultCode):
    """The result code of a row, with its sentence and its verdict.

    Tables store the numbers: existing numbers must not change, and new ones are added at the end.

    Example:
        >>> import gaitsweep as gs
        >>> gs.Status.cycle_limit.sentence
        'The row reached run.max_cycles without settling.'
        >>> gs.Status.cycle_limit.verdict.name
        'undecided'
        >>> gs.Status.FAILED.among(["settled", "fell"]).tolist()
        [False, True]
    """

    running = 0, "The row has not ended yet."
    settled = (
        1,
        "The state at the section stopped changing, or repeats every 2 to `max_period` crossings.",
        Verdict.sound,
    )
    cycle_limit = 2, "The row reached run.max_cycles without settling."
    fell = 3, "The body fell: the model's function `failed` became true.", Verdict.failed
    diverged = (
        4,
        "A state variable grew past 1e9 in its own unit; where such values are usual, take a larger unit.",
        Verdict.failed,
    )
    not_a_number = 5, "A state variable became NaN, or the model's period is not finite.", Verdict.failed
    event_stall = (
        6,
        "Events followed each other at one instant without end (stalled_by names them).",
        Verdict.failed,
    )
    time_limit = (
        7,
        "The row reached run.max_time, or four nominal periods for each allowed cycle and ten more.",
    )
    complete = 8, "The row recorded everything that its run requires.", Verdict.sound
    inferred = 9, "The row was not simulated: its neighbours decide its label.", Verdict.sound
    step_limit = (
        10,
        "The row needed more steps than its limit, which follows from its time limit and its longest step.",
    )
    no_fixed_point = 11, "No fixed point was found at which a branch could begin."
    at_rest = (
        12,
        "All rates of the flow vanished for good: the row is at a fixed point of the flow.",
        Verdict.sound,
    )
    chaotic = (
        13,
        "The crossings do not repeat: their largest Lyapunov exponent is positive beyond its error.",
        Verdict.sound,
    )
    quasi_periodic = (
        14,
        "The crossings return without repeating, and neighbours neither separate nor approach.",
        Verdict.sound,
    )

    SOUND = _StatusesWith(Verdict.sound)
    UNDECIDED = _StatusesWith(Verdict.undecided)
    FAILED = _StatusesWith(Verdict.failed)


# Statuses of rows on attractors without a period, whose crossings a table lists as a sample of the attractor.
RECURRENT = StatusNames({"chaotic", "quasi_periodic"})


class Outcome(enum.StrEnum):
    """The outcomes of rows without a gait; the outcome of other rows is their gait."""

    NO_GAIT = "none"  # a sound row whose gait the model does not name
    NOT_SETTLED = "not settled"
    FAILED = "failed"


class SetStatus(enum.StrEnum):
    """Statuses of a set of constants, in the table of a search or a sensitivity analysis.

    Such a table has no rows of a sweep, so its column `status` has these names in place of those of `Status`.
    """

    COMPLETE = "complete"  # every target or output has a value
    FAILED = "failed"  # one of them has none

    @classmethod
    def column(cls, failed: Bool[np.ndarray, " sets"]) -> pd.Categorical:
        """Return the column `status` of a table, from a mask of the sets that failed."""
        import pandas as pd  # only a search or a sensitivity analysis has such a column

        return pd.Categorical.from_codes(failed.astype(int), [str(status) for status in cls])

    def among(self, table: pd.DataFrame) -> Bool[np.ndarray, " sets"]:
        """Return a mask of the sets of a table that have this status."""
        return (table["status"].astype(str) == str(self)).to_numpy(bool)
