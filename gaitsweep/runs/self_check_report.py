"""What a self-check found, in words."""

from __future__ import annotations

from typing import Any

# What is made finer where steps follow from no tolerance.
HALF_THE_STEP = "half the step"
# A settled row may move by this many times the tolerance of settling.
TOLERANCES = 10.0


def sentence(found: dict[str, Any]) -> str:
    """What a self-check found, on one line."""
    if found.get("verdict") == "off":
        return "Self-check: off."
    largest = {name: value for name, value in found.get("largest", {}).items() if value == value}
    most = max(largest, key=lambda name: largest[name]) if largest else None
    change = f"largest change {largest[most]:.1e} of {most}" if most is not None else "nothing to compare"
    sensitive = f", {found['sensitive']} on a boundary" if found.get("sensitive") else ""
    rows = f"{found['rows']} row{'s' * (found['rows'] != 1)}"
    text = f"Self-check: {rows} repeated with {found['half']}: "
    if found["verdict"] == "passed":
        return f"{text}same status and gait{sensitive}, {change}."
    wrong = [
        f"{found[name]} came to another {word}"
        for name, word in (("status_differs", "status"), ("gait_differs", "gait"))
        if found.get(name)
    ]
    if found.get("moved"):
        wrong.append(f"{found['moved']} moved by more than {TOLERANCES:g} tolerances")
    return f"{text}{', '.join(wrong)}{sensitive}, {change}."


def advice(found: dict[str, Any], dt: float | None) -> str:
    """What to change where a self-check warned."""
    if dt is not None:
        return f"The table depends on the step: make numerics.dt shorter than {dt:g} s, or leave it out."
    if found.get("half") != HALF_THE_STEP:
        return "The table depends on the tolerances: make numerics.rtol and numerics.atol finer."
    return "The table depends on the step: give a shorter one, numerics.dt, and compare."
