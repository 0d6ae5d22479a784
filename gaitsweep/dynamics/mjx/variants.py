"""Bodies for MJX whose masses and lengths vary between rows, compiled on the host for each distinct set.

MuJoCo's compiler computes constants from a body's masses and lengths (subtree masses, inverse inertias at
points, ...). They would be wrong if a mass were changed in an mjx.Model, so each set of values is compiled,
and the fields that differ are passed for each row.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Num

from gaitsweep.dynamics.mjx.mjx_body import mjx
from gaitsweep.errors import ArgumentError

# Number of compiled sets of values that are cached, for later blocks of rows.
_MOST_CACHED = 1024
# Fields for rendering, and fields that MJX does not read.
_LOOKS = ("cam_", "light_", "tex_", "mat_")
_UNREAD = ("body_sameframe", "geom_sameframe", "site_sameframe", "body_simple", "dof_simplenum", "geom_aabb")

# Prefixes of the names that `on_host` adds: fields of the model, and the values that they follow from.
_FIELD = "mjx."
_MADE_OF = "mjx of "
_CHANGE = 0.1  # of a value, as a share of it, or of 1 for 0, by which the fields that depend on it are found

Edit: TypeAlias = Callable[[Any, Mapping[str, float]], None]
Fields: TypeAlias = dict[str, np.ndarray]


class Variants:
    """The fields of an mjx.Model that depend on a few values, such as masses and lengths.

    The fields are found by changing one value at a time, so that every row has the same fields.

    Args:
        xml: the MJCF.
        edit: a function that sets a new mujoco.MjSpec of it to some values, by name.
        usual: valid values, by name.
    """

    def __init__(self, xml: str, edit: Edit, usual: Mapping[str, float]) -> None:
        self._xml = xml
        self._edit = edit
        self._names = tuple(usual)
        self._usual = self._compiled(tuple(usual.values()))
        changing: set[str] = set()
        for name in usual:
            value = usual[name] * (1.0 + _CHANGE) or _CHANGE
            fields = self._compiled(tuple({**usual, name: value}.values()))
            changing |= {
                field for field, value in fields.items() if not np.array_equal(value, self._usual[field])
            }
        if fixed := changing & (self._usual.keys() - _DYNAMIC):
            raise ArgumentError(f"MJX cannot take {', '.join(sorted(fixed))} of a body from row to row.")
        self.fields = tuple(sorted(changing))
        self._fields_of = lru_cache(_MOST_CACHED)(self._varying_fields)

    def numbers(self, columns: Mapping[str, Float[np.ndarray, " rows"]]) -> Fields:
        """The fields of each row (n, ...), from columns (n,) of the values.

        Raises:
            ValueError: MuJoCo does not compile the body with some row's values.
        """
        rows = np.stack([np.asarray(columns[name], np.float64) for name in self._names], axis=1)
        distinct, which = np.unique(rows, axis=0, return_inverse=True)
        sets = [self._fields_of(tuple(values)) for values in distinct.tolist()]
        return {field: np.stack([fields[field] for fields in sets])[which.ravel()] for field in self.fields}

    def on_host(self, columns: Mapping[str, Float[np.ndarray, " rows"]]) -> Fields:
        """The values (n,) of rows and their fields (n, ...) by name, as returned by `Model.on_host`."""
        fields = {_FIELD + name: field for name, field in self.numbers(columns).items()}
        return {**columns, **fields, **{_MADE_OF + name: columns[name] for name in self._names}}

    def of_row(self, values: Mapping[str, Float[Array, " ..."]]) -> dict[str, Num[Array, " ..."]]:
        """The fields among a row's values; NaN if masses or lengths have changed since (by a ramp).

        Empty if the values have not passed through `on_host`; this is enough if the body is not simulated.
        """
        if _MADE_OF + self._names[0] not in values:
            return {}
        same = jnp.all(jnp.stack([values[name] == values[_MADE_OF + name] for name in self._names]))
        return {name: jnp.where(same, values[_FIELD + name], jnp.nan) for name in self.fields}

    def _varying_fields(self, values: tuple[float, ...]) -> Fields:
        """The fields of the body with these values; refuses one that changes others."""
        fields = self._compiled(values)
        moved = [name for name, value in fields.items() if not np.array_equal(value, self._usual[name])]
        if astray := set(moved) - set(self.fields):
            raise self._error(values, f"MJX cannot take {', '.join(sorted(astray))}")
        return {name: fields[name] for name in self.fields}

    def _compiled(self, values: tuple[float, ...]) -> Fields:
        """The fields of the body with these values, which may affect its motion."""
        spec = mujoco.MjSpec.from_string(self._xml)
        self._edit(spec, dict(zip(self._names, values, strict=True)))
        try:
            model = spec.compile()
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise self._error(values, f"MuJoCo refuses the body: {reason}") from error
        return {name: np.array(getattr(model, name)) for name in _FIELDS}

    def _error(self, values: tuple[float, ...], reason: str) -> ArgumentError:
        """The error of a body with these values."""
        named = ", ".join(f"{n} {v:g}" for n, v in zip(self._names, values, strict=True))
        return ArgumentError(f"With {named}, {reason}.")


def rescale(
    spec: Any, mass: Mapping[str, float], size: Mapping[str, float | Float[np.ndarray, " 3"]]
) -> None:
    """Scale masses and lengths of some bodies of a mujoco.MjSpec, as `articulated_tree.rescaled` does.

    Args:
        spec: bodies with explicit inertials along their own axes; geoms are not scaled, so contacts must be
            off.
        mass: by body, the factor of its mass and inertia.
        size: by body, the factor of its lengths, a scalar or one for each axis (3,) of its frame.

    Raises:
        ArgumentError: a body's inertia comes from its geoms, is rotated, or is a fullinertia.
    """
    for name in {**mass, **size}:
        body = spec.body(name)
        # until a body is compiled, its other orientations and a fullinertia are beside `iquat` and `inertia`
        is_turned = body.ialt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT
        is_turned |= not np.array_equal(body.iquat, [1.0, 0.0, 0.0, 0.0])
        if not body.explicitinertial or is_turned or np.isfinite(body.fullinertia[0]):
            raise ArgumentError(
                f"Body '{name}' needs an inertial along its own axes, with diaginertia, to be rescaled."
            )
        heavier = mass.get(name, 1.0)
        larger = size.get(name, 1.0) * np.ones(3)
        # the second moments of mass, of which the inertia is trace less moment, scale by axis
        moment = (0.5 * body.inertia.sum() - body.inertia) * larger * larger
        body.mass = heavier * body.mass
        body.inertia = heavier * (moment.sum() - moment)
        body.ipos = larger * body.ipos
        for part in (*body.bodies, *body.joints, *body.sites):
            part.pos = larger * part.pos


def _fields() -> tuple[str, ...]:
    """The arrays of an mjx.Model that can affect the motion."""
    plain = mujoco.MjModel.from_xml_string("<mujoco/>")
    names = [field.name for field in mjx.Model.fields()]
    arrays = [name for name in names if isinstance(getattr(plain, name, None), np.ndarray)]
    return tuple(name for name in arrays if not name.startswith(_LOOKS) and name not in _UNREAD)


_FIELDS = _fields()
# Fields that a compiled program can take as inputs.
_DYNAMIC = {field.name for field in mjx.Model.fields() if field.type is jax.Array}
