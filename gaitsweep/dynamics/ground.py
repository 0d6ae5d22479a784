"""Uneven ground: its height at a place, which a model's functions read as `params.ground(x)`.

The ground is even up to x = 0, where rows start, and its height there is 0. Beyond, each kind of ground is a
continuous function of the place whose random heights depend on the seed and the place alone (`noise`).
"""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import Model, Quantity
from gaitsweep.dynamics.random_numbers import normal
from gaitsweep.errors import ArgumentError
from gaitsweep.near_miss import suggestion

# The kinds that a job names; a profile is read from a file.
KINDS = ("even", "slope", "steps", "rough")
PROFILE = "profile"
# The share of a step's length over which the ground rises to the next step: guards have to be continuous.
RISER = 0.05
MOST_POINTS = 200  # each segment of a profile is written out in a kernel

_RANDOM = (
    Quantity("ground_seed", "1", "seed of the ground: the same seed is the same ground", 0.0, whole=True),
    Quantity("ground_roughness", "m", "standard deviation of the heights of the ground", 0.0, low=0.0),
    Quantity("ground_width", "m", "distance between heights that are drawn", 0.5, low=0.0, open_ends=True),
)
_QUANTITIES = {
    "even": (),
    "slope": (
        Quantity(
            "ground_slope", "deg", "slope of the ground beyond x = 0, upwards", 0.0, low=-45.0, high=45.0
        ),
    ),
    "steps": _RANDOM,
    "rough": _RANDOM,
    PROFILE: (Quantity("ground_start", "m", "place of the profile at which rows start, x = 0", 0.0),),
}
_MARK = "asks for the ground"


def ground_field() -> Any:
    """The field `ground: str = gs.ground_field()` of a model whose functions read `params.ground(x)`.

    The key `ground` of a job, or the argument of the class, then chooses the kind of ground, and the model
    has the parameters of that kind: `ground_seed`, `ground_roughness` and `ground_width` for `steps` and
    `rough`, `ground_slope` for `slope`, `ground_start` for a profile.

    Example:
        >>> import dataclasses, gaitsweep as gs
        >>> @dataclasses.dataclass(frozen=True)
        ... class Stroll(gs.DeclaredModel):
        ...     ground: str = gs.ground_field()
        ...     x = gs.variable("m", "place of the foot", 1.2)
        ...
        ...     def flow(self, p, s):
        ...         return {"x": 1.0}
        ...
        ...     @gs.signal("m", "height of the ground under the foot")
        ...     def height(self, p, s):
        ...         return p.ground(s.x)
        ...
        ...     def period(self, p):
        ...         return 1.0
        >>> [quantity.name for quantity in Stroll(ground="steps").parameters]
        ['ground_seed', 'ground_roughness', 'ground_width']
    """
    meaning = f"kind of ground: {', '.join(KINDS)}, or a profile"
    return dataclasses.field(default="even", metadata={"meaning": meaning, "later": True, _MARK: True})


def asks_for_ground(kind: type) -> bool:
    """Whether models of this class have a field of `ground_field`."""
    field = getattr(kind, "__dataclass_fields__", {}).get("ground", vars(kind).get("ground"))
    return isinstance(field, dataclasses.Field) and _MARK in field.metadata


def check_ground(ground: Any) -> str:
    """Return the text of a kind of ground, or of a profile from `ground_profile`.

    Raises:
        ArgumentError: it is neither, with the kinds that there are.
    """
    kind = str(ground).split(" ", 1)[0]
    if kind == PROFILE:
        _points(str(ground))
    elif ground not in KINDS:
        near = suggestion(str(ground), KINDS)
        raise ArgumentError(f"ground is {ground}, which is no kind of ground{near}")
    return str(ground)


def ground_profile(path: str | Path) -> str:
    """Read a profile of the ground for the argument `ground` of a model.

    Args:
        path: a CSV file with two columns, place x (m, increasing) and height z (m), with or without a line of
            names; from 2 to 200 points. Between them the ground is straight, beyond the ends level.

    Returns:
        Text with the points themselves, so that stored jobs do not need the file.

    Raises:
        ArgumentError: the file cannot be read, or is no such profile.
    """
    try:
        with open(path, newline="", encoding="utf-8") as file:
            lines = [line for line in csv.reader(file) if line]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ArgumentError(f"{path} cannot be read as a profile of the ground: {error}.") from None
    numbers = []
    for count, line in enumerate(lines):
        try:
            x, z = (float(text) for text in line)
        except ValueError:
            if count == 0:
                continue
            text = (
                f"line {count + 1} is {','.join(line)}, but must be two numbers, a place and a height in m."
            )
            raise ArgumentError(f"{path} is no profile of the ground: {text}") from None
        numbers += [x, z]
    text = " ".join([PROFILE, *(repr(number) for number in numbers)])
    try:
        _points(text)
    except ArgumentError as error:
        raise ArgumentError(f"{path} is no profile of the ground: {error}") from None
    return text


def _points(text: str) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """The places and heights (m) of a profile as text; raises ArgumentError."""
    try:
        numbers = np.asarray([float(word) for word in text.split()[1:]])
    except ValueError as error:
        raise ArgumentError(f"ground is a profile, but {error}.") from None
    if numbers.size % 2 or not 4 <= numbers.size <= 2 * MOST_POINTS:
        raise ArgumentError(
            f"a profile has {numbers.size / 2:g} points, but must have from 2 to {MOST_POINTS}."
        )
    x = numbers[::2]
    z = numbers[1::2]
    if not np.isfinite(numbers).all() or not (np.diff(x) > 0.0).all():
        raise ArgumentError("the places of a profile must be finite and increase.")
    return x, z


def is_uneven(model: Model) -> bool:
    """Whether a model asks for the ground, and it is not even."""
    return asks_for_ground(type(model)) and getattr(model, "ground", "even") != "even"


def ground_quantities(ground: str) -> tuple[Quantity, ...]:
    """The parameters of a kind of ground, or of a profile."""
    return _QUANTITIES[ground.split(" ", 1)[0]]


def _along(profile: str, x: Float[Array, " ..."]) -> Float[Array, " ..."]:
    """The height (m) of a profile at places x (m), less that of its first point."""
    places, heights = _points(profile)
    segments = zip(places, np.diff(places), np.diff(heights), strict=False)
    rises = (rise * jnp.clip((x - place) / length, 0.0, 1.0) for place, length, rise in segments)
    return sum(rises, start=jnp.zeros_like(x))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Ground:
    """The ground of a row: a kind, and the values of its parameters by name."""

    kind: str = dataclasses.field(metadata={"static": True})
    values: Mapping[str, Float[Array, ""]]

    @classmethod
    def of(cls, ground: str, values: Mapping[str, Any]) -> Ground:
        """The ground of a kind, from the values of all parameters of a row by name."""
        return cls(ground, {q.name: jnp.asarray(values[q.name]) for q in ground_quantities(ground)})

    def __call__(self, x: Float[Array, " ..."]) -> Float[Array, " ..."]:
        """The height (m) at places x (m)."""
        if self.kind == "even":
            return jnp.zeros_like(x)
        if self.kind == "slope":
            return jnp.tan(jnp.deg2rad(self.values["ground_slope"])) * jnp.maximum(x, 0.0)
        if self.kind in ("steps", "rough"):
            return self._drawn(x)
        start = self.values["ground_start"]
        return jnp.where(x > 0.0, _along(self.kind, start + x) - _along(self.kind, start), 0.0)

    def _drawn(self, x: Float[Array, " ..."]) -> Float[Array, " ..."]:
        """Heights that are drawn at multiples of `ground_width`, from 1 on, with smooth rises between."""
        places = x / self.values["ground_width"]
        index = jnp.floor(places)
        share = places - index
        if self.kind == "steps":
            share = jnp.clip((share - (1.0 - RISER)) / RISER, 0.0, 1.0)
        rise = share * share * (3.0 - 2.0 * share)
        behind = self._height(index)
        ahead = self._height(index + 1.0)
        return behind + (ahead - behind) * rise

    def _height(self, index: Float[Array, " ..."]) -> Float[Array, " ..."]:
        seed = self.values["ground_seed"]
        roughness = self.values["ground_roughness"]
        return jnp.where(index > 0.0, roughness * normal(seed, index), 0.0)
