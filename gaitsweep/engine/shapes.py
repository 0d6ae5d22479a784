"""Types of the arrays of one trajectory."""

from __future__ import annotations

from jaxtyping import Array, Bool, Float, Int

Number = Float[Array, ""]
Flag = Bool[Array, ""]
Integer = Int[Array, ""]
Guards = Float[Array, " guards"]  # one number for each guard of a model
GuardFlags = Bool[Array, " guards"]
Observed = Float[Array, " observables"]
