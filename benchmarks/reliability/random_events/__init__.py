"""Random hybrid models whose events have a closed or an independent solution, for `reliability.events`."""

from __future__ import annotations

from . import balls, cells, signals, wheels
from .family import Family

FAMILIES: tuple[Family, ...] = (*balls.FAMILIES, *wheels.FAMILIES, *cells.FAMILIES, *signals.FAMILIES)
