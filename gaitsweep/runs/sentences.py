"""Sentences about a run: statuses of rows, its self-check, and remarks, from its manifest."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from gaitsweep.dynamics.gaits_by_footfalls import ALTERNATE, TOGETHER
from gaitsweep.kinds.columns import UNKNOWN_GAIT
from gaitsweep.runs.provenance import NOT_INSTALLED
from gaitsweep.status import SetStatus, Status
from gaitsweep.table.manifest import BY_STEP, BY_STEP_WORDS, DIFFERENCES, STORED_DIFFERS, UNSTABLE

# Fields of the manifest.
MISLABELLED = "mislabelled"  # rows whose label is not the index of a gait
STARTS_BEYOND = "starts_beyond"  # rows that begin beyond an event's surface
WITHOUT_START = "without_start"  # rows whose start the model could not make
WITHOUT_STRIDES = "without_strides"  # rows of a model with footfalls of which no row has a stride
UNEVEN_STRIDES = "uneven_strides"  # rows of no gait of which a foot lands more than once a stride
WITHOUT_GAIT = "without_gait"  # other rows of no gait, by the reason
NO_STRIDE, SEVERAL, OTHER_LAGS, UNSETTLED = "no_stride", "several", "other_lags", "unsettled"
SHORT_CONTACTS = "short_contacts"  # settled rows whose gait has another name for twice `shortest_contact`
BACKWARDS = "backwards"  # settled rows whose body walks backwards
WITHOUT_PERIOD = "without_period"  # rows whose nominal period is not a positive time
REMARKS = (
    BACKWARDS, MISLABELLED, SHORT_CONTACTS, STARTS_BEYOND, UNEVEN_STRIDES, WITHOUT_GAIT, WITHOUT_PERIOD,
    WITHOUT_START, WITHOUT_STRIDES,
)  # fmt: skip
# Words about several rows, and those about one.
_OF_ONE = {"their": "its", "rest": "rests", "lie": "lies", "are": "is"}
_MOST_VALUES = 4  # of a row that a sentence names
# Settled rows that repeat after one crossing.
_AT = {"1": "at a fixed point"}
# How the meaning of a function begins that tests something.
_TESTS = ("whether", "return", "test", "if ", "true ")
# Name of a result, for jobs whose rows are sets of constants.
_RESULTS = {"search": "target", "sensitivity": "output"}


def self_check_sentence(check: dict[str, Any]) -> str:
    """Format the result of a self-check, on one line."""
    if check.get("verdict") == "off":
        return "Self-check: off."
    rows = check["rows"]
    total = check["of"]
    sample = f"{rows} row{'s' * (rows != 1)}" if rows == total else f"{rows} of {total} rows"
    finer = check["finer"]
    sensitive = check.get("sensitive")
    change = _largest(check)
    rerun = f"Self-check: {sample} rerun {'at' if 'step' in finer else 'with'} {finer}"
    if check["verdict"] == "passed":
        among = f", {sensitive} of them on a boundary or sensitive" if sensitive else ""
        if check.get(BY_STEP):
            among += f", but {check[BY_STEP]} {BY_STEP_WORDS.sentence}"
        return f"{rerun} kept {'its' if rows == 1 else 'their'} gait{among}; {change}."
    wrong = [
        _counted(check[name], words.sentence) + (_first_unstable(check) if name == UNSTABLE else "")
        for name, words in DIFFERENCES.items()
        if check.get(name)
    ]
    if sensitive:
        wrong.append(_counted(sensitive, "lie on a boundary or are sensitive"))
    if check.get(BY_STEP):
        wrong.append(f"{check[BY_STEP]} {BY_STEP_WORDS.sentence}")
    return f"{rerun}: {', '.join(wrong)}; {change}."


def _counted(count: int, words: str) -> str:
    """A number of rows with what they do; the words are those of several rows."""
    if count == 1:
        for several, one in _OF_ONE.items():
            words = re.sub(rf"\b{several}\b", one, words)
    return f"{count} {words}"


def _first_unstable(check: dict[str, Any]) -> str:
    """Name the first row on an unstable gait, with the moving parameter or the axes there, if known."""
    first = dict(check.get("unstable_first") or {})
    if not first:
        return ""
    row = first.pop("row")
    values = ", ".join(f"{name} = {value:.6g}" for name, value in list(first.items())[:_MOST_VALUES])
    return f" (first row {row}{' at ' if values else ''}{values})"


def _largest(check: dict[str, Any]) -> str:
    """Format the largest change of an observable."""
    largest = {name: value for name, value in check.get("largest", {}).items() if value == value}
    if not largest:
        return "no observable was compared"
    worst = check["worst"]
    unit = "" if worst["unit"] == "1" else f" {worst['unit']}"
    name = "the time of a crossing" if worst["name"] == "t" else worst["name"]
    return f"{name} changed by at most {largest[worst['name']]:.1e}{unit}"


def advice(check: dict[str, Any], dt: float | None) -> str:
    """Advise what to change where a self-check warned.

    Args:
        check: its result, from the manifest.
        dt: the step (s) that the job gives, if it does.
    """
    wrong = [name for name in DIFFERENCES if check.get(name)]
    if wrong == [STORED_DIFFERS]:
        return "Another model, data file, cache or version made this table: run the job into a new directory."
    if wrong == [UNSTABLE]:
        return (
            "Such rows begin on that gait, or their legs are alike to the last digit, from the start or once "
            "they have merged, and stay alike: let a parameter of one leg differ a little, or by more if it "
            "does already, so that the gait is left within a row or a dwell, or make these longer. "
            "kind: continuation tells stability."
        )
    if dt is not None:
        return f"The table depends on the step: make numerics.dt shorter than {dt:g} s, or leave it out."
    if "step" not in check["finer"]:
        return (
            "The table depends on the steps: make numerics.rtol and numerics.atol finer, or numerics.dt "
            "shorter, and compare."
        )
    return "The table depends on the step: give a shorter one, numerics.dt, and compare."


def lengths_of_steps(dt: object) -> str:
    """Format the shortest and the longest of the rows' steps (s): "0.02 to 0.03 s"; empty if unknown."""
    spans = [f"{step:.6g}" for step in dt] if isinstance(dt, list) else []
    return f"{' to '.join(dict.fromkeys(spans))} s" if spans else ""


# The time of a self-check after the rows, among the timings of a manifest.
SELF_CHECK_SECONDS = "self_check_s"
# Settings of a run by title: the entries of its manifest, each with its words.
_SETTINGS = {
    "paper": {"source": "{}"},
    "integration": {"method": "{}", "dt": "steps of {}", "precision": "{}"},
    "computed by": {"engine": "engine {}", "device": "{}", "lanes": "{} trajectories at a time"},
    "time": {
        "compile_s": "{:.3g} s to compile",
        "run_s": "{:.3g} s to run",
        SELF_CHECK_SECONDS: "{:.3g} s for the self-check",
        "attempts": "{:.0f} steps",
    },
    "machine": {"machine": "{}"},
    "program": {"gaitsweep": "gaitsweep {}", "git_commit": "commit {}", "created": "started {}"},
    "versions": {"versions": "{}"},
    "files": {"block": "parts of {} rows", "format": "format {}"},
    "hash of the job": {"job_hash": "{}"},
}
# Where to read on about gaits; the second is the subject of a sentence.
FOOTFALLS_AND_NAMES = "`Footfalls and names of gaits`, in the page that `gaitsweep examples own_model` copies"
IF_IT_DOES_NOT_WALK = "`If it does not walk`, in the page that `gaitsweep examples walker` copies,"
# Entries of a manifest that `settings_of` describes.
DESCRIBED = {"timings", *_SETTINGS, *(name for words in _SETTINGS.values() for name in words)}


def settings_of(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Describe with units how a table was made, by title; what the manifest does not say is left out."""
    versions = manifest.get("versions", {}).items()
    known = {
        **manifest, **manifest.get("timings", {}), **manifest.get("paper", {}),
        "dt": lengths_of_steps(manifest.get("dt")),
        "versions": ", ".join(f"{name} {version}" for name, version in versions if version != NOT_INSTALLED),
    }  # fmt: skip
    lines = {
        title: ", ".join(form.format(known[name]) for name, form in words.items() if known.get(name))
        for title, words in _SETTINGS.items()
    }
    return {title: text for title, text in lines.items() if text}


def status_sentence(status: str, job: Mapping[str, Any], manifest: Mapping[str, Any] | None = None) -> str:
    """Return the sentence of a status; empty for a status of another version of gaitsweep.

    Args:
        status: its name.
        job: the job, whose limits the sentence names.
        manifest: that of the table, if known, whose `periods` are settled rows by the number of crossings
            after which they repeat, and whose `quantities` say what `failed` of the model tests.
    """
    manifest = manifest or {}
    for field, result in _RESULTS.items():
        if field in job:
            return _sentence_of_set(status, result)
    run = job.get("run", {})
    periods = manifest.get("periods")
    if status == Status.settled.name and periods:
        orbits = [
            f"{rows} {_AT.get(period, f'on an orbit of {period} crossings')}"
            for period, rows in periods.items()
        ]
        return f"The state at the section repeats: {', '.join(orbits)}."
    sentence = Status[status].sentence if status in Status.__members__ else ""
    if status == Status.fell.name:
        meaning = (manifest.get("quantities") or {}).get("status", {}).get("meaning", "")
        return fall_sentence(meaning)
    if status == Status.not_a_number.name and manifest.get("method") == "taylor":
        return (
            f"{sentence} The root of a variable, such as sqrt(x), has no Taylor series where x is 0: if the "
            "flow has one, write numerics.method: tsit5."
        )
    if status == Status.complete.name and run.get("kind") == "staircase":
        return "All stairs were recorded; the column `settled` says at the end of which the gait had settled."
    if status == Status.time_limit.name:
        of_job, _, otherwise = sentence.removesuffix(".").partition(", or ")
        limit = run.get("max_time")
        return f"The row reached {otherwise}." if limit is None else f"{of_job}, {limit:g} s."
    most = f", {run['max_cycles']} cycles," if "max_cycles" in run else ""
    return sentence.replace("run.max_cycles", f"run.max_cycles{most}")


def fall_sentence(meaning_of_status: str) -> str:
    """The sentence of a row that fell, from the meaning of the column `status` (see `quantities_of`)."""
    _, _, fall = meaning_of_status.partition("; fell: ")
    if not fall:
        return Status.fell.sentence
    if fall.startswith(_TESTS):
        return f"{Status.fell.sentence} It tests {fall.removeprefix('return ').removeprefix('returns ')}."
    return f"The body fell: {fall}."


def _sentence_of_set(status: str, result: str) -> str:
    """The sentence of the status of a set of constants; `result` is a target or an output."""
    if status == SetStatus.COMPLETE:
        return f"Every {result} has a value for this set of constants."
    if status == SetStatus.FAILED:
        return f"Some {result} has no value for this set; the column `why` says which and why."
    return ""


def remarks(manifest: Mapping[str, Any]) -> list[str]:
    """Return sentences about results that the author of a job may not expect."""
    sentences = []
    for name, about in (manifest.get(WITHOUT_PERIOD) or {}).items():
        sentences.append(
            f"Warning: the model's function period gave {name} in {_rows(about)}, but must give "
            "seconds above 0: limits of time and of steps follow from it."
        )
    for reason, about in (manifest.get(WITHOUT_START) or {}).items():
        sentences.append(f"Warning: {_rows(about)} could not begin: {reason}.")
    for name, about in (manifest.get(STARTS_BEYOND) or {}).items():
        sentences.append(
            f"{_rows(about)} began where the function of the event {name!r} is zero or above. The event "
            "happens when its function rises through zero: not at that start, and never if the function "
            "does not fall below zero first. Start before the event if it should happen."
        )
    for name, about in (manifest.get(MISLABELLED) or {}).items():
        label = name.removeprefix(UNKNOWN_GAIT).strip(" ()")
        sentences.append(
            f"Warning: the model's function label gave gait {label} in {_rows(about)}, which is not an index "
            f"of its gaits; their gait is {name!r} in the table."
        )
    for model, about in (manifest.get(WITHOUT_STRIDES) or {}).items():
        sentences.append(_without_strides(model, about))
    if uneven := manifest.get(UNEVEN_STRIDES):
        sentences.append(_uneven_strides(uneven))
    if without_gait := manifest.get(WITHOUT_GAIT):
        sentences += _without_gait(without_gait)
    if short_contacts := manifest.get(SHORT_CONTACTS):
        sentences.append(_short_contacts(short_contacts))
    if backwards := manifest.get(BACKWARDS):
        verb = "walks" if backwards["rows"] == 1 else "walk"
        sentences.append(
            f"{_rows(backwards)} settled, but {verb} backwards: the mean speed of a cycle is "
            f"{'' if backwards['rows'] == 1 else 'down to '}{backwards['fastest']:.3g} m/s. A hinge at "
            'the hip with axis="0 -1 0" swings ahead at positive angles; else reverse the sign of its swing.'
        )
    return sentences


def _without_gait(about: Mapping[str, Any]) -> list[str]:
    """Format why rows have no gait, with the numbers of rows."""
    reasons = dict(about["reasons"])
    lags = "the lags of its feet are those of no gait"
    if about.get("legs") == 2:
        lags = "its feet neither alternate nor land together: lag_2 / (2 pi) is "
        lags += f"within {ALTERNATE:g} of 1/2 in a walk or run, and within {TOGETHER:g} of 0 in a hop"
    feet = " or ".join(reasons.get(NO_STRIDE, {}).get("feet", ()))
    lacking = f"foot {feet}" if feet else "a foot"
    words = {
        NO_STRIDE: f"{lacking} has no stride: it stands, is held up, or has not landed twice",
        SEVERAL: "its strides differ on an orbit of several crossings",
        OTHER_LAGS: lags,
    }
    page = f"({FOOTFALLS_AND_NAMES})"
    sentences = []
    if unsettled_rows := reasons.pop(UNSETTLED, None):
        sentences.append(
            f"{_rows(unsettled_rows)} reached the limit of cycles with the gait none, since strides differ: "
            "they repeat after several crossings, if at all, or a foot lands more than once a stride, such "
            f"as one that bounces {page}."
        )
    if reasons:
        total = sum(rows["rows"] for rows in reasons.values())
        subject = "1 settled row has" if total == 1 else f"{total} settled rows have"
        listed = "; ".join(f"in {_rows(rows)} {words[reason]}" for reason, rows in reasons.items())
        sentences.append(f"{subject} the gait none: {listed} {page}.")
    return sentences


def _short_contacts(about: Mapping[str, Any]) -> str:
    """Format that names of gaits depend on `shortest_contact`."""
    shares = " to ".join(dict.fromkeys(f"{share:.2g}" for share in about["share"]))
    known = f"`shortest_contact`, {about['shortest_contact']:g}"
    return (
        f"The gait of {_rows(about)} depends on {known}: with twice that, a stance or swing of foot "
        f"{' or '.join(about['feet'])} would not count, which lasts for {shares} of the model's period "
        f"({FOOTFALLS_AND_NAMES})."
    )


def _uneven_strides(about: Mapping[str, Any]) -> str:
    """Format the feet that land more than once a stride, and how a scuff is left out."""
    rows = sum(of_foot["rows"] for of_foot in about["feet"].values())
    first = min(of_foot["row"] for of_foot in about["feet"].values())
    feet = []
    for foot, of_foot in about["feet"].items():
        contact = " to ".join(dict.fromkeys(f"{seconds:.2g}" for seconds in of_foot["contact"]))
        in_rows = f" in {_rows(of_foot)}" if len(about["feet"]) > 1 else ""
        last = f"has {contact} s" if contact else "is longer than that stride"
        feet.append(f"foot {foot}{in_rows}: its last contact {last}")
    advice = (
        " A short one in mid-swing is a scuff, which `shortest_contact` in the model file leaves out: "
        f"{IF_IT_DOES_NOT_WALK} describes it."
        if about.get("body")
        else ""
    )
    subject = "1 row has" if rows == 1 else f"{rows} rows have"
    return (
        f"{subject} no gait, since a foot lands more than once a stride (the first is row {first}; "
        f"{'; '.join(feet)}).{advice}"
    )


def _without_strides(model: str, about: Mapping[str, Any]) -> str:
    """Format which feet of a model have no stride in any row, and what may be the cause."""
    feet = about.get("feet") or []
    subject = f"Foot {', '.join(feet)} of {model} has" if feet else f"No foot of {model} has"
    if about.get("body"):
        landed = "it has" if len(feet) == 1 else "they have"
        return (
            f"{subject} {'no' if feet else 'a'} stride in any row: {landed} not landed twice, so "
            "there are no lags and no names of gaits. Look at the movie, at the height of the start, and at "
            "contype and conaffinity of foot and floor in the MJCF."
        )
    return (
        f"{subject} {'no' if feet else 'a'} stride in any row: feet stand, have not landed twice, or `feet` "
        "changes between events, where touchdowns are not counted. Footfalls need a function `feet` that "
        "changes only at events or by modes."
    )


def plain(value: object) -> str:
    """Format a value of a manifest on one line."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {plain(inner)}" for key, inner in value.items())
    if isinstance(value, list):
        return ", ".join(map(plain, value))
    return str(value)


def unsettled(slowest: Mapping[str, int]) -> str:
    """Format the observables that prevented settling: "psi_1 in 12 rows, psi_2 in 1 row"."""
    return ", ".join(f"{name} in {rows} row{'s' * (rows != 1)}" for name, rows in slowest.items())


def repeating(manifest: Mapping[str, Any]) -> str:
    """Format that errors of the integration keep rows from settling, after a space; "" if none is known."""
    check = manifest.get("self_check")
    if not isinstance(check, dict) or not (about := check.get("repeating")):
        return ""
    several, period = about["rows"] != 1, about["period"]
    at = f"within {period} crossings" if period > 1 else "at each crossing"
    return (
        f" {about['rows']} of {about['of']} such rows that were rerun repeat{'s' * (not several)} {at} up to "
        f"errors of the integration ({about['observable']}: {about['motion']:.1g} of its size, or "
        f"{about['finer_motion']:.1g} with {check['finer']}): a finer numerics.rtol may let "
        f"{'them' if several else 'it'} settle."
    )


def axes(of_job: Sequence[Mapping[str, Any]]) -> str:
    """Format the axes with their numbers of points: "psi_2 (99) x psi_1 (99)"."""
    return " x ".join(
        f"{' and '.join(axis['names'])} ({axis['length']}{', drawn' if axis['drawn'] else ''})"
        for axis in of_job
    )


def _rows(about: Mapping[str, Any]) -> str:
    """Format a number of rows and the first of them: "3 rows (the first is row 7)"."""
    examined = f" of {about['of']} that were examined" if "of" in about else ""
    if about["rows"] == 1:
        return f"1 row (row {about['row']}){examined}"
    return f"{about['rows']} rows (the first is row {about['row']}){examined}"
