"""The order of events along branches: which events a gait has, when, and what changes from point to point."""

from __future__ import annotations

import itertools
from collections import Counter
from typing import Any

from gaitsweep.engine.poincare.maps import Events
from gaitsweep.run_columns import time_column


def event_columns(events: Events) -> dict[str, Any]:
    """The columns of a gait's events: their order in words, and the time (s) of each event's first time."""
    times: dict[str, Any] = {}
    for at, name in events:
        times.setdefault(time_column(name), at)
    return {"events": ", ".join(name for _, name in events), **times}


def change_of_order(before: Events, after: Events) -> str:
    """The difference in the order of events of two gaits, in words; empty if there is none.

    Example:
        >>> from gaitsweep.analysis.atlas.event_orders import change_of_order
        >>> change_of_order([(0.1, "foot 1 lands"), (0.2, "foot 2 lifts")], [(0.1, "foot 2 lifts")])
        'without foot 1 lands'
    """
    first, second = ([name for _, name in events] for events in (before, after))
    # one that leaves the end of the cycle comes to its beginning; the last event is that of the section
    for moved in dict.fromkeys(first[:-1]):
        rest = [name for name in first[:-1] if name != moved]
        ends = [moved, *rest], [*rest, moved]
        if len(rest) > 1 and first != second and first[:-1] in ends and second[:-1] in ends:
            return f"{moved} passes the section"
    numbered, place = _numbered(first), {event: k for k, event in enumerate(_numbered(second))}
    swapped = [
        f"{a[0]} and {b[0]} change places"
        for a, b in itertools.combinations([event for event in numbered if event in place], 2)
        if place[b] < place[a]
    ]
    gone, come = Counter(first) - Counter(second), Counter(second) - Counter(first)
    words = [*swapped, *(f"without {name}" for name in gone), *(f"with {name}" for name in come)]
    return ", ".join(dict.fromkeys(words))


def _numbered(names: list[str]) -> list[tuple[str, int]]:
    """Names with how often each came before."""
    seen: Counter[str] = Counter()
    numbered = []
    for name in names:
        numbered.append((name, seen[name]))
        seen[name] += 1
    return numbered
