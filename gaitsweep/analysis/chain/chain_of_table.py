"""The parameters of the theory for a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analysis.records import AnalysisError
from gaitsweep.expression import ExpressionError, evaluate
from gaitsweep.models.multilegged.theory.chain import Chain

# defaults that follow from other parameters
_FORMULAS = {"m_1": "m_B", "m_end": "m_B", "kappa_1": "kappa", "kappa_end": "kappa", "a_1": "a", "a_end": "a"}


def chain_of(table: pd.DataFrame) -> Chain:
    """The chain of a table: its first row's columns, else its job's parameters, else Table 1's.

    Raises:
        AnalysisError: the job's parameters cannot be read.
    """
    chain = chains_of(table, table.head(1))
    return Chain(*(float(np.asarray(value, float).flat[0]) for value in chain))


def chains_of(table: pd.DataFrame, sets: pd.DataFrame) -> Chain:
    """The chains of n sets of parameters, fields (n,) each.

    Args:
        table: its job, in `attrs`, gives the parameters that do not vary.
        sets: the columns that vary, one row for each set.

    Raises:
        AnalysisError: as for `chain_of`.
    """
    values = parameters_of(table, sets)
    shape = (max(len(sets), 1),)
    return Chain(**{name: np.broadcast_to(values[name], shape) for name in Chain._fields})


def parameters_of(table: pd.DataFrame, sets: pd.DataFrame) -> dict[str, Any]:
    """The theory's parameters with L and m_B, numbers or (n,); arguments and errors as for `chains_of`."""
    job = table.attrs.get("job")
    given: dict[str, Any] = dict(job.get("params") or {}) if isinstance(job, Mapping) else {}
    varied = [str(name) for name in sets.columns if len(sets) and _known(str(name))]
    given |= {name: sets[name].to_numpy(float) for name in varied}
    plain = {name: value for name, value in Chain()._asdict().items() if name not in _FORMULAS}
    values: dict[str, Any] = {"m_B": 0.9, "L": 1.0, **plain}
    values |= {name: value for name, value in given.items() if not isinstance(value, str)}
    for name, formula in (_FORMULAS | given).items():
        if isinstance(formula, str) and _known(name):
            try:
                values[name] = evaluate(formula, values)
            except ExpressionError as error:
                raise AnalysisError(f"The job's {name} cannot be read: {error}") from error
    return values


def _known(name: str) -> bool:
    return name in Chain._fields or name in ("m_B", "L")
