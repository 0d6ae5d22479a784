"""Messages about the result of a self-check."""

from __future__ import annotations

from typing import Any

# The finer steps in manifests of older versions, which halved the step.
HALF_THE_STEP = "half the step"
# A settled row may move by this many times the tolerance of settling.
TOLERANCES = 10.0


def sentence(check: dict[str, Any]) -> str:
    """Format the result of a self-check, on one line."""
    if check.get("verdict") == "off":
        return "Self-check: off."
    rows, of = check["rows"], check.get("of", check["rows"])
    sample = f"{rows} row{'s' * (rows != 1)}" if rows == of else f"{rows} of {of} rows"
    finer = check.get("finer") or check.get("half", HALF_THE_STEP)
    how = f"rerun {'at' if 'step' in finer else 'with'} {finer}"
    change = _largest(check)
    if check["verdict"] == "passed":
        sensitive = (
            f", {check['sensitive']} of them on a boundary or sensitive" if check.get("sensitive") else ""
        )
        return f"Self-check: {sample} {how} kept their gait{sensitive}; {change}."
    wrong = [
        f"{check[name]} {text}"
        for name, text in (
            ("stored_differs", "did not reproduce their stored records with the same steps"),
            ("status_differs", "ended with another status"),
            ("gait_differs", "ended with another gait"),
            ("count_differs", "ended with another count"),
            ("moved", f"moved by more than {TOLERANCES:g} tolerances"),
        )
        if check.get(name)
    ]
    if check.get("sensitive"):
        wrong.append(f"{check['sensitive']} lie on a boundary or are sensitive")
    return f"Self-check: {sample} {how}: {', '.join(wrong)}; {change}."


def _largest(check: dict[str, Any]) -> str:
    """Format the largest change of an observable; manifests of older versions do not name the worst."""
    largest = {name: value for name, value in check.get("largest", {}).items() if value == value}
    if not largest:
        return "there was nothing to compare"
    worst = check.get("worst") or {"name": max(largest, key=lambda name: largest[name]), "unit": "1"}
    unit = "" if worst["unit"] == "1" else f" {worst['unit']}"
    name = "the time of a crossing" if worst["name"] == "t" else worst["name"]
    return f"{name} changed by at most {largest[worst['name']]:.1e}{unit}"


def advice(check: dict[str, Any], dt: float | None) -> str:
    """Advise what to change where a self-check warned."""
    differs = ("status_differs", "gait_differs", "count_differs", "moved")
    if check.get("stored_differs") and not any(check.get(name) for name in differs):
        text = "Another model, data file, cache or version made this table"
        return f"{text}: run the job into a new directory."
    if dt is not None:
        return f"The table depends on the step: make numerics.dt shorter than {dt:g} s, or leave it out."
    if "step" not in (check.get("finer") or check.get("half", HALF_THE_STEP)):
        return (
            "The table depends on the steps: make numerics.rtol and numerics.atol finer, or numerics.dt "
            "shorter, and compare."
        )
    return "The table depends on the step: give a shorter one, numerics.dt, and compare."
