"""Do the loads of the trot without feedback foretell the walk that comes of it once loads are fed back?

The rule says that every gait comes of a trot by the loads on its feet. Against loads and shifts of one and
the same gait this is hardly tested, since legs that swing one after the other are loaded unlike because of
it. Here loads and tilt are those of a trot whose legs swing together, the shift that of the walk at the same
parameters. Canters and gallops are left out: which of two mirror images comes is the start's choice.

    python -m gaitsweep.analysis.gaits.load_prediction results/planar_quadruped_offset
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd

from gaitsweep.analysis.gaits.loading_rule import MEASURES, REPEATS, axes_of_pairs, loading_rule, pairs_in
from gaitsweep.analysis.records import AnalysisError

WALKS = ("L-walk", "D-walk")


def foretelling(table: pd.DataFrame, feedback: str = "k2") -> pd.DataFrame:
    """The loads of trots without feedback beside the shifts of the walks with it, for `loading_rule`.

    Args:
        table: as for `loading_rule.pairs_in`, with and without feedback over the same other parameters.
        feedback: the column of the feedback's gain, 0 in some rows.

    Returns:
        One record for each set of parameters at which all rows without feedback trot and all rows with it
        come to one walk: row (its number), what varies, gait (the walk), pair_number (0: the mean of both),
        delta (of the walk, cycles), and the `MEASURES` that the table tells, of the trot.

    Raises:
        AnalysisError: a column is not there, or no row is without feedback.
    """
    pairs = pairs_in(table)
    names = [name for name in MEASURES if name in pairs.columns]
    axes = [name for name in axes_of_pairs(pairs) if name not in REPEATS]
    if feedback not in axes or 0.0 not in set(pairs[feedback]):
        raise AnalysisError(f"No row has {feedback} = 0: the table has to hold trots without feedback too.")
    places = [name for name in axes if name != feedback]
    without = pairs.loc[pairs[feedback] == 0.0]
    trots = without.groupby(places)["gait"].agg(lambda gaits: (gaits.astype(str) == "trot").all())
    loads = without.groupby(places)[names].mean().loc[trots]
    walking = pairs.loc[pairs[feedback] != 0.0].groupby(axes)
    walks = walking.agg(
        gait=("gait", "first"), gaits=("gait", "nunique"), delta=("delta", "mean")
    ).reset_index()
    walks = walks.loc[walks["gait"].isin(WALKS) & (walks["gaits"] == 1)]
    found = walks.merge(loads, left_on=places, right_index=True).reset_index(drop=True)
    found.insert(0, "row", np.arange(len(found)))
    return found.assign(pair_number=0)[["row", *axes, "gait", "pair_number", "delta", *names]]


def main() -> None:
    from gaitsweep.table import load

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("directory", help="a result directory with rows without and with load feedback")
    found = foretelling(load(parser.parse_args().directory))
    told = loading_rule(found, split="k2", repeats=())
    print(told.round(3).to_string(index=False))


if __name__ == "__main__":
    main()
