"""Uneven ground: its height at a place, which a model's functions read as `params.ground(x)`.

The ground is even up to x = 0, where rows start, and its height there is 0. Beyond, each kind of ground is a
continuous function of the place whose random heights depend on the seed and the place alone (`noise`).
"""

from __future__ import annotations

import csv
import dataclasses
import functools
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
# Half the length (m) over which a bend is rounded for bodies, which meet tangent planes: these have to be
# continuous.
ROUNDING = 0.01

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
    if _kind(str(ground)) == PROFILE:
        _profile(str(ground))
    elif ground not in KINDS:
        near = suggestion(str(ground), KINDS)
        raise ArgumentError(f"ground is {ground}, which is not a kind of ground{near}")
    return str(ground)


def ground_profile(path: str | Path) -> str:
    """Read a profile of the ground for the argument `ground` of a model.

    Args:
        path: a CSV file with two columns, place x (m, increasing) and height z (m), with or without a line of
            two names; from 2 to 200 points. Between them the ground is straight, beyond the ends level.

    Returns:
        Text with the points themselves, so that stored jobs do not need the file.

    Raises:
        ArgumentError: the file cannot be read, or is not such a profile.
    """
    try:
        # spreadsheets begin a file in UTF-8 with a byte order mark
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            rows = [(reader.line_num, cells) for cells in reader if cells]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ArgumentError(f"{path} cannot be read as a profile of the ground: {error}.") from None
    if rows and len(rows[0][1]) == 2 and not any(map(_is_number, rows[0][1])):  # names of the columns
        del rows[0]
    numbers: list[float] = []
    for line, cells in rows:
        try:
            x, z = (float(cell) for cell in cells)
        except ValueError:
            text = f"line {line} is {','.join(cells)}, but must be two numbers, a place and a height in m."
            raise ArgumentError(f"{path} is not a profile of the ground: {text}") from None
        numbers += [x, z]
    text = " ".join([PROFILE, *(repr(number) for number in numbers)])
    try:
        _profile(text)
    except ArgumentError as error:
        raise ArgumentError(f"{path} is not a profile of the ground: {error}") from None
    return text


def _is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _kind(ground: str) -> str:
    """The kind of ground that a text describes: its first word."""
    return ground.split(" ", 1)[0]


@dataclasses.dataclass(frozen=True)
class Profile:
    """A profile of the ground: its points' places and heights (m), in tuples, so that it is a key of JAX."""

    places: tuple[float, ...]
    heights: tuple[float, ...]

    def height(self, x: Float[Array, " ..."], rounding: float = 0.0) -> Float[Array, " ..."]:
        """The height (m) at places x (m), less that of the first point."""
        shares = self.shares(x, rounding)
        parts = (rise * share for rise, share in zip(np.diff(self.heights), shares, strict=True))
        return sum(parts, start=jnp.zeros_like(x))

    def shares(self, x: Float[Array, " ..."], rounding: float = 0.0) -> list[Float[Array, " ..."]]:
        """The share of each segment, from 0 to 1, that is behind places x (m)."""
        places = np.asarray(self.places)
        lengths = np.diff(places)
        if not rounding:
            return [
                jnp.clip((x - place) / length, 0.0, 1.0)
                for place, length in zip(places, lengths, strict=False)
            ]
        # no further than the middle of a segment, so that each keeps its slope there
        shorter = np.minimum(np.append(lengths, np.inf), np.insert(lengths, 0, np.inf))
        ramps = [
            _rounded(x - place, half)
            for place, half in zip(places, np.minimum(rounding, 0.5 * shorter).tolist(), strict=True)
        ]
        return [(begin - end) / length for begin, end, length in zip(ramps, ramps[1:], lengths, strict=False)]


def _rounded(x: Float[Array, " ..."], half: float) -> Float[Array, " ..."]:
    """max(x, 0), with a parabola in place of its bend from -half to half."""
    if not half:
        return jnp.maximum(x, 0.0)
    inside = jnp.clip(x + half, 0.0, 2.0 * half)
    return inside * inside / (4.0 * half) + jnp.maximum(x - half, 0.0)


@functools.lru_cache(maxsize=64)
def _profile(text: str) -> Profile:
    """The profile that a text describes; raises ArgumentError."""
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
    return Profile(tuple(x.tolist()), tuple(z.tolist()))


def is_uneven(model: Model) -> bool:
    """Whether the ground of a model is uneven, by the kind that it asks for or by its own steps and hills."""
    model = model.original  # that of pushed rows too
    has_own = type(model).own_ground is not Model.own_ground
    return chooses_uneven(model) or (has_own and model.own_ground(jnp.zeros(1), jnp.zeros(1)) is not None)


def chooses_uneven(model: Model) -> bool:
    """Whether the field `ground` of a model has another value than even."""
    model = model.original
    return asks_for_ground(type(model)) and getattr(model, "ground", "even") != "even"


def heights_of_model(
    model: Model, values: Mapping[str, float], x: Float[np.ndarray, " places"]
) -> Float[np.ndarray, " places"] | None:
    """The heights (m) of a model's ground at places x (m), y = 0; None where it is even.

    Args:
        model: the model.
        values: the parameters of a row by name.
        x: the places, m.
    """
    model = model.original
    if not is_uneven(model):
        return None
    own = model.own_ground(jnp.asarray(x), jnp.zeros(len(x)))
    heights = np.zeros(len(x)) if own is None else np.asarray(own)
    if chooses_uneven(model):
        heights = heights + np.asarray(Ground.of(model.ground, values)(jnp.asarray(x)))  # type: ignore[attr-defined]
    return heights


def ground_quantities(ground: str) -> tuple[Quantity, ...]:
    """The parameters of a kind of ground, or of a profile."""
    return _QUANTITIES[_kind(ground)]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Ground:
    """The ground of a row: a kind, the values of its parameters by name, and the profile of that kind.

    Bends of `slope` and of a profile are rounded by parabolas, as long on either side as `rounding` (m).
    """

    kind: str = dataclasses.field(metadata={"static": True})
    values: Mapping[str, Float[Array, ""]]
    profile: Profile | None = dataclasses.field(default=None, metadata={"static": True})
    rounding: float = dataclasses.field(default=0.0, metadata={"static": True})

    @classmethod
    def of(cls, ground: str, values: Mapping[str, Any]) -> Ground:
        """The ground of a row of a model.

        Args:
            ground: a kind of ground, or a profile as text.
            values: the parameters of the row by name; those of other things are ignored.
        """
        kind = _kind(ground)
        own = {quantity.name: jnp.asarray(values[quantity.name]) for quantity in ground_quantities(ground)}
        return cls(kind, own, _profile(ground) if kind == PROFILE else None)

    def normal(self, x: Float[Array, " ..."]) -> Float[Array, "... 3"]:
        """The unit vectors across the ground at places x (m), upwards."""
        _, slope = self.height_and_slope(jnp.asarray(x))
        across = jnp.stack([-slope, jnp.zeros_like(slope), jnp.ones_like(slope)], axis=-1)
        return across / jnp.sqrt(1.0 + slope * slope)[..., None]

    def __call__(self, x: Float[Array, " ..."]) -> Float[Array, " ..."]:
        """The height (m) at places x (m)."""
        if self.kind == "even":
            return jnp.zeros_like(x)
        if self.kind == "slope":
            return jnp.tan(jnp.deg2rad(self.values["ground_slope"])) * _rounded(x, self.rounding)
        if self.kind in ("steps", "rough"):
            return self._drawn(x)
        assert self.profile is not None
        start = self.values["ground_start"]
        ahead = start + (_rounded(x, self.rounding) if self.rounding else x)
        height = self.profile.height(ahead, self.rounding) - self.profile.height(start, self.rounding)
        return jnp.where(x > 0.0 - self.rounding, height, 0.0)

    def height_and_slope(self, x: Float[Array, " ..."]) -> tuple[Float[Array, " ..."], Float[Array, " ..."]]:
        """The height (m) at places x (m), and its derivative (1) by the place."""
        return jax.jvp(self, (x,), (jnp.ones_like(x),))

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
