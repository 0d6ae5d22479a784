"""The starts of a model that have no effect."""

from __future__ import annotations

from typing import Any

import jax

from gaitsweep.contract import Model
from gaitsweep.dynamics.declared_model import DeclaredModel
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.trace import Tracer, UnsupportedError
from gaitsweep.engine.stored_traces import dependences, stored

_SCALAR = jax.ShapeDtypeStruct((), float)


@cached_by_content(maxsize=64)
def idle_starts(model: Model) -> tuple[str, ...]:
    """The names of starts on which the state at t = 0 does not depend; of a model with a body, none."""
    if model.host_parameters:
        return ()
    return tuple(stored("idle_starts", model, (), lambda: _idle_starts(model)))


def _idle_starts(model: Model) -> list[str]:
    """`idle_starts` of a model that has not been traced before."""
    parameters = {quantity.name: _SCALAR for quantity in model.parameters}
    shapes = (parameters, {quantity.name: _SCALAR for quantity in model.initial_conditions})

    def begun(values: Any, start: Any) -> Any:
        return model.init(model.params(values), start)

    tracer = Tracer(Program())
    inputs = tracer.inputs(shapes, 0, steady=False)
    starts = jax.tree.unflatten(jax.tree.structure(shapes), inputs)[1]
    try:
        state = tracer.read(jax.make_jaxpr(begun)(*shapes), inputs)
    except UnsupportedError:
        read = frozenset[str]().union(*dependences(begun, *shapes))
        return [name for name in starts if name not in read]
    needed = set(tracer.program.needed(node for leaf in state for node in leaf.ravel().tolist()))
    return [name for name, node in starts.items() if int(node) not in needed]


def sets_starts(model: Model) -> str:
    """The function that sets the starts in `idle_starts`."""
    own = isinstance(model, DeclaredModel) and type(model).complete is not DeclaredModel.complete
    return "complete" if own else "init"
