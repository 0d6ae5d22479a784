"""Validators of scalar fields (numbers, words, flags) and their error messages.

A number may be an expression. In `run`, `numerics` and `figures` it becomes a float while the job is read,
over the parameters that stay fixed (`SCOPE`); in `params`, `start` and `vary` one that names parameters
stays text, as these may change from row to row.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Annotated, Any, get_args

import numpy as np
from pydantic import GetCoreSchemaHandler, PlainValidator, WithJsonSchema
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from gaitsweep import near_miss
from gaitsweep.errors import JobError
from gaitsweep.expression import CONSTANTS, ExpressionError, evaluate, names_used
from gaitsweep.schema.diagnostics import Diagnostic, quoted


@dataclass(frozen=True)
class Scope:
    """Names that expressions outside `vary` may use, and reasons why other names are not allowed.

    `evaluated` collects the expressions that became numbers.
    """

    fixed: Mapping[str, float] = field(default_factory=dict)
    moving: Mapping[str, str] = field(default_factory=dict)  # name -> "varies in this job"
    known: bool = True  # False while the model is unknown, which is reported: then all names are accepted
    evaluated: set[str] = field(default_factory=set)


SCOPE: ContextVar[Scope | None] = ContextVar("SCOPE", default=None)

MAX_POINTS = 10**7  # of an axis

_POSITIVE_ZERO = 0.0  # added to -0.0 it gives 0.0, which gives the same rows
_LONGEST_TEXT = 1000  # characters
_LONGEST_AMBIGUOUS = 99  # characters of a text that is compared with the patterns of ambiguous numbers
_STEM = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
# Control characters but tabs and line ends, and halves of surrogate pairs.
_NOT_TEXT = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")
# Texts that look like numbers to some readers, each with the end of the message that refuses it.
_AMBIGUOUS: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"^\s*\d+:\d"), "which some YAML readers read in base 60; write a plain number"),
    (re.compile(r"^\s*\d{4}-\d{1,2}-\d{1,2}([Tt ].*)?\Z"), "which is a date, not a number"),
    (
        re.compile(r"^\s*[-+]?0\d+\s*\Z"),
        "which some readers read in base 8; write it without the leading zero",
    ),
    (re.compile(r"^\s*[-+]?\.?(inf(inity)?|nan)\s*\Z", re.IGNORECASE), "but must be a finite number"),
    (re.compile(r"^\s*[-+]?\d+,\d+\s*\Z"), "but the decimal point must be a dot"),
    (re.compile(r"^\s*(yes|no|on|off|true|false)\s*\Z", re.IGNORECASE), "but must be a number"),
)


def control_character(value: str) -> str | None:
    """Return the first character of a text that figures cannot show, in words, or None."""
    wrong = _NOT_TEXT.search(value)
    return None if wrong is None else f"the control character U+{ord(wrong[0]):04X}"


class InvalidValue(ValueError):
    """A value that a field does not allow; the message follows the field's name."""


def read_number(value: Any) -> float | str:
    """Read a float, or the text of an expression that names parameters, without spaces.

    Raises:
        InvalidValue: it is not a finite number or arithmetic; YAML's traps (1:30, 010, dates) are explained.
    """
    if isinstance(value, str):
        if not near_miss.spend("expressions"):  # the reading ends with one error, not one for each number
            text = f"has more than {near_miss.BUDGET['expressions']} numbers written as text or expressions."
            raise JobError([Diagnostic((), text)])
        for pattern, sentence in _AMBIGUOUS:
            if len(value) <= _LONGEST_AMBIGUOUS and pattern.match(value):
                raise InvalidValue(f"is {quoted(value)}, {sentence}.")
        try:
            return "".join(value.split()) if names_used(value) else evaluate(value, {}) + _POSITIVE_ZERO
        except ExpressionError as error:
            raise InvalidValue(f"is not a number: {error}") from None
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise InvalidValue(f"is {quoted(value)}, but must be a number.")
    try:
        return evaluate(float(value), {}) + _POSITIVE_ZERO
    except (ExpressionError, OverflowError):
        raise InvalidValue(f"is {quoted(value)}, but must be a finite number.") from None


def read_fixed(value: Any) -> float | None:
    """Read a float, with expressions over the job's `SCOPE`; None if the names are not known yet.

    Raises:
        InvalidValue: as `read_number`; or a name varies in this job or is unknown to the model.
    """
    number = read_number(value)
    if not isinstance(number, str):
        return number
    scope = SCOPE.get() or Scope()
    if not scope.known:
        return None
    for name in sorted(names_used(number) - scope.fixed.keys()):
        reason = f"is unknown here{near_miss.suggestion(name, [*scope.fixed, *CONSTANTS])}"
        if name in scope.moving:
            reason = f"{scope.moving[name]}, and this field has one value for all rows."
        raise InvalidValue(f'is "{number}", but {name} {reason}')
    scope.evaluated.add(number)
    try:
        return evaluate(number, scope.fixed) + _POSITIVE_ZERO
    except ExpressionError as error:
        raise InvalidValue(f"is not a number: {error}") from None


def bound(low: float, high: float, *, open_ends: bool) -> str:
    """Write bounds in words: "above 0", "from 0 to 1", "between 0 and 1, ends excluded".

    Args:
        low, high: the bounds; one of them may be infinite.
        open_ends: whether the bounds themselves are excluded.
    """
    least, most = shown(low), shown(high)
    if math.isinf(high):
        return f"{'above' if open_ends else 'at least'} {least}"
    if math.isinf(low):
        return f"{'below' if open_ends else 'at most'} {most}"
    return f"between {least} and {most}, ends excluded" if open_ends else f"from {least} to {most}"


def shown(number: float) -> str:
    """Write a number in six digits, or in as many as tell it from others: 3, or 3.0000000000000004."""
    short = f"{number:g}"
    return short if float(short) == number else repr(float(number))


def read_real(
    value: Any, low: float = -math.inf, high: float = math.inf, *, open_ends: bool = False
) -> float:
    """Read a float within its bounds, NaN while the names in its expression are not known.

    Args:
        value: a number or an expression.
        low, high, open_ends: as for `bound`.

    Raises:
        InvalidValue: as `read_fixed`; or it is out of bounds.
    """
    number = read_fixed(value)
    if number is None:
        return math.nan
    if not (low < number < high if open_ends else low <= number <= high):
        raise InvalidValue(f"is {shown(number)}, but must be {bound(low, high, open_ends=open_ends)}.")
    return number


def read_whole(value: Any, low: int, high: int) -> int:
    """Read an int within its bounds, the lowest while the names in its expression are not known.

    Args:
        value: a number or an expression.
        low, high: the bounds, which are allowed.

    Raises:
        InvalidValue: as `read_fixed`; or it is no whole number, or out of bounds.
    """
    number = read_fixed(value)
    if number is None:
        return low
    if number != math.floor(number):
        raise InvalidValue(f"is {shown(number)}, but must be a whole number.")
    if not low <= number <= high:
        raise InvalidValue(f"is {shown(number)}, but must be a whole number from {low} to {high}.")
    return int(number)


def read_positive_or_each(value: Any) -> float | dict[str, float]:
    """Read a number above 0, or one for each of some names.

    Raises:
        InvalidValue: a number is not above 0, or a mapping has no names.
    """
    if not isinstance(value, Mapping):
        return read_real(value, low=0.0, open_ends=True)
    if not value:
        text = "must be a number above 0, or such numbers by the names of observables."
        raise InvalidValue(f"is an empty mapping, but {text}")
    positive_numbers = {}
    for name, number in value.items():
        try:
            positive_numbers[read_text(name)] = read_real(number, low=0.0, open_ends=True)
        except InvalidValue as error:
            raise InvalidValue(f"has {name}, which {error}") from None
    return positive_numbers


def read_text(value: Any) -> str:
    """Read text, without the line feed at the end of a YAML block.

    Raises:
        InvalidValue: it is no text, is empty or too long, or has a control character.
    """
    if not isinstance(value, str):
        quotes = ": put it in quotes" if isinstance(value, (int, float)) else ""
        raise InvalidValue(f"is {quoted(value)}, but must be text{quotes}.")
    if not value.strip():
        raise InvalidValue("is empty, but must be text.")
    if len(value) > _LONGEST_TEXT:
        raise InvalidValue(f"is {quoted(value)}, which is longer than {_LONGEST_TEXT} characters.")
    if (wrong := control_character(value)) is not None:
        raise InvalidValue(f"contains {wrong}, which is not allowed in text.")
    return value.rstrip("\n")


def read_stem(value: Any) -> str:
    """Read text that can name a file, without spaces around it.

    Raises:
        InvalidValue: it is no such text.
    """
    text = read_text(value).strip()
    if not _STEM.fullmatch(text):
        rule = "letters, digits, _ - . that begins with a letter or digit"
        raise InvalidValue(f"is {quoted(text)}, but must be a file name of {rule}.")
    return text


def read_flag(value: Any) -> bool:
    """Read a boolean.

    Raises:
        InvalidValue: it is another value, such as 1 or yes.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise InvalidValue(f"is {quoted(value)}, but must be true or false.")
    return bool(value)


def read_word(value: Any, allowed: tuple[str, ...]) -> str:
    """Read one of the allowed words.

    Args:
        value: the value.
        allowed: the words.

    Raises:
        InvalidValue: it is another word, with the near miss.
    """
    if not isinstance(value, str) or value not in allowed:
        raise InvalidValue(f"is {quoted(value)}{near_miss.suggestion(str(value), allowed)}")
    return value


def checked(read: Callable[..., Any], **limits: Any) -> Callable[[Any], Any]:
    """Wrap a reader for pydantic: InvalidValue becomes the error whose text is printed.

    Args:
        read: the reader.
        limits: its further arguments.
    """

    def validate(value: Any) -> Any:
        """Read a value within the limits."""
        try:
            return read(value, **limits)
        except InvalidValue as error:
            raise wrong_value(str(error)) from None

    return validate


def wrong_value(text: str) -> PydanticCustomError:
    """Return the error of a pydantic validator whose text is printed after the field's name."""
    return PydanticCustomError("gaitsweep", "{text}", {"text": text})


_NUMBER_TYPE = {"type": ["number", "string"]}
_EACH_TYPE = {"type": "object", "additionalProperties": _NUMBER_TYPE, "minProperties": 1}
_NUMBER = WithJsonSchema(_NUMBER_TYPE)
WHOLE = WithJsonSchema({"type": ["integer", "string"]})
_TEXT = WithJsonSchema({"type": "string"})

Number = Annotated[float | str, PlainValidator(checked(read_number)), _NUMBER]
Real = Annotated[float, PlainValidator(checked(read_real)), _NUMBER]
Positive = Annotated[float, PlainValidator(checked(read_real, low=0.0, open_ends=True)), _NUMBER]
PositiveOrEach = Annotated[
    float | dict[str, float],
    PlainValidator(checked(read_positive_or_each)),
    WithJsonSchema({"anyOf": [_NUMBER_TYPE, _EACH_TYPE]}),
]
NotNegative = Annotated[float, PlainValidator(checked(read_real, low=0.0)), _NUMBER]
Count = Annotated[int, PlainValidator(checked(read_whole, low=1, high=10**9)), WHOLE]
LaneCount = Annotated[int, PlainValidator(checked(read_whole, low=1, high=2**20)), WHOLE]
CountOrZero = Annotated[int, PlainValidator(checked(read_whole, low=0, high=10**9)), WHOLE]
VerifyCount = Annotated[int, PlainValidator(checked(read_whole, low=0, high=10_000)), WHOLE]
PointCount = Annotated[int, PlainValidator(checked(read_whole, low=1, high=MAX_POINTS)), WHOLE]
Seed = Annotated[int, PlainValidator(checked(read_whole, low=0, high=2**53)), WHOLE]
Text = Annotated[str, PlainValidator(checked(read_text)), _TEXT]
Stem = Annotated[str, PlainValidator(checked(read_stem)), _TEXT]
Flag = Annotated[bool, PlainValidator(checked(read_flag)), WithJsonSchema({"type": "boolean"})]


@dataclass(frozen=True)
class Word:
    """Annotation of a Literal, for the message about another word."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        read = checked(read_word, allowed=get_args(source))
        return core_schema.no_info_before_validator_function(read, handler(source))
