"""The measures that claims may name: general ones here, and those that extensions bring."""

from __future__ import annotations

from gaitsweep.claims.measures import general as general
from gaitsweep.extension import extensions, import_all

for _extension in extensions().values():
    import_all(_extension.measures)
