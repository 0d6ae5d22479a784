"""Result directories: parts that survive any interruption, refusals, and loaded tables."""

from __future__ import annotations

import copy
import errno
import json
import os
import pickle
import resource
import signal
import subprocess
import sys
import textwrap
import time
import tracemalloc
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from gaitsweep.table import (
    ResultDirectory,
    Snapshot,
    TableError,
    WriteError,
    examination,
    load,
    load_parts,
    parquet_parts,
)
from gaitsweep.table.atomic_files import read_file, reason, replace_file
from gaitsweep.table.manifest import Layout, json_value
from gaitsweep.table.parquet_parts import arrow_part, readable
from tests.support.toy_directories import GAITS, JOB, block_frame, files_of, fill, open_toy


def test_a_new_directory_is_filled_and_loaded(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "toy"
    with open_toy(path) as directory:
        assert directory.missing_blocks() == [0, 1, 2]
        fill(directory)
        directory.update_manifest(seconds=np.float64(1.5), lanes=256)
        assert directory.missing_blocks() == []
        assert sum(directory.counts().values()) == directory.rows_done == 10
    table = load(path)
    expected = block_frame(0, 10)
    assert list(table["row"]) == list(range(10))
    assert table["row"].dtype == np.int64
    assert list(table["gait"].cat.categories) == GAITS
    assert table["gait"].isna().equals(expected["gait"].isna())
    assert list(table["status"].astype(str)) == list(expected["status"].astype(str))
    assert table.attrs["complete"]
    assert table.attrs["job"] == JOB
    assert table.attrs["manifest"]["seconds"] == 1.5
    assert table.attrs["manifest"]["lanes"] == 256
    assert yaml.safe_load((path / "job.yaml").read_text()) == JOB
    assert Snapshot.of(path).counts == directory.counts()


def test_columns_carry_their_unit_and_meaning_in_the_parquet_field(tmp_path: Path) -> None:
    path = tmp_path / "toy"
    quantities = {"a": {"unit": "m/s", "meaning": "speed", "symbol": "a", "circular": False}}
    with open_toy(path) as directory:
        directory.write_part(0, block_frame(0, 4))  # as an older version wrote it, without metadata
        directory.update_manifest(quantities=quantities)
        fill(directory)
    old, new = (pq.read_schema(path / "table" / f"part-0000{number}.parquet") for number in (0, 1))
    assert new.field("a").metadata == {b"unit": b"m/s", b"meaning": b"speed"}
    assert new.field("cycles").metadata == {b"unit": b"1", b"meaning": b"section crossings of the row"}
    assert new.field("status").metadata == {b"meaning": b"how the row ended"}
    assert old.field("a").metadata is None
    assert old.equals(new)
    pd.testing.assert_series_equal(load(path).loc[:, "a"], block_frame(0, 10).loc[:, "a"])


def test_columns_of_a_run_kind_carry_theirs_unless_the_model_has_a_quantity_of_that_name() -> None:
    frame = pd.DataFrame({"row": [0], "status": ["settled"], "t_end": [1.5], "cycles": [3], "t": [0.5]})
    quantities = {"t": {"unit": "K", "meaning": "temperature"}}
    data = arrow_part(frame, 0, "hash", {"settled": 1}, quantities).encoded().data
    fields = pq.read_schema(pa.BufferReader(data))
    assert fields.field("t_end").metadata == {b"unit": b"s", b"meaning": b"time at the end of the row"}
    assert fields.field("t").metadata == {b"unit": b"K", b"meaning": b"temperature"}


def test_operations_on_a_table_share_its_attrs(tmp_path: Path) -> None:
    """The copies that pandas makes in each operation took milliseconds, and seconds with a long axis."""
    with open_toy(tmp_path / "toy") as directory:
        fill(directory)
        directory.update_manifest(long=[0.5] * 100, short=[{"a": 1}])
    table = load(tmp_path / "toy")
    manifest, copied = table.attrs["manifest"], table[["row"]].attrs["manifest"]
    assert copied is manifest
    assert yaml.safe_load(yaml.safe_dump(copied)) == json.loads(json.dumps(copied)) == manifest
    assert yaml.safe_load(yaml.dump(copied)) == manifest
    assert pickle.loads(pickle.dumps(table)).attrs == table.attrs


def test_what_copies_of_a_table_share_is_not_changed(tmp_path: Path) -> None:
    with open_toy(tmp_path / "toy") as directory:
        fill(directory)
        directory.update_manifest(short=[{"a": 1}])
    attrs = load(tmp_path / "toy").attrs
    for change in (
        lambda manifest: manifest.update(short=[]),
        lambda manifest: manifest["short"].append({}),
        lambda manifest: manifest["short"][0].pop("a"),
    ):
        with pytest.raises(TypeError, match=r"deepcopy"):
            change(attrs["manifest"])
        change(copy.deepcopy(attrs["manifest"]))
    assert attrs["manifest"]["short"] == [{"a": 1}]


def test_a_partial_table_is_loaded_with_a_warning(tmp_path: Path) -> None:
    with open_toy(tmp_path / "toy") as directory:
        directory.write_part(2, block_frame(8, 10))
        directory.write_part(0, block_frame(0, 4))
    table = load(tmp_path / "toy")
    assert list(table["row"]) == [0, 1, 2, 3, 8, 9]
    assert not table.attrs["complete"]


@pytest.mark.parametrize(
    "rows",
    [slice(3, 9), slice(None, None, 3), slice(9, 2, -2), range(1, 10, 4), [8, 2, 2, 5], np.array([0]), []],
    ids=str,
)
def test_chosen_rows_and_columns_are_those_of_the_whole_table(tmp_path: Path, rows: Any) -> None:
    path = tmp_path / "toy"
    with open_toy(path) as directory:
        fill(directory)
    whole = load(path)
    chosen = np.arange(10)[rows] if isinstance(rows, slice) else np.array(rows, int)
    expected = whole.loc[whole["row"].isin(chosen.tolist())].reset_index(drop=True)
    pd.testing.assert_frame_equal(load(path, rows=rows), expected, check_exact=True)
    columns = ["gait", "psi_2_end"]
    table = load(path, columns, rows)
    pd.testing.assert_frame_equal(table, expected[columns], check_exact=True)
    assert table.attrs["manifest"]["rows"] == 10


def test_all_records_of_a_chosen_row_are_read(tmp_path: Path) -> None:
    frame = block_frame(0, 10).loc[np.repeat(np.arange(10), 3)].reset_index(drop=True)
    with open_toy(tmp_path / "toy") as directory:
        for number in range(3):
            start, stop = directory.layout.rows_of(number)
            directory.write_part(number, frame[frame["row"].between(start, stop - 1)])
    assert load(tmp_path / "toy", ["row"], [2, 7])["row"].tolist() == [2, 2, 2, 7, 7, 7]


@pytest.mark.parametrize(
    ("wanted", "sentence"),
    [
        ({"columns": ["gate"]}, r"gate is not a column of .*toy; did you mean gait\? Allowed: row, a"),
        ({"rows": [3, 10]}, "rows contains 10, but the table has rows 0 to 9."),
        ({"rows": range(-2, 3)}, "rows contains -2, but the table has rows 0 to 9."),
        ({"rows": [0.5]}, "rows contains 0.5, but must be a slice"),
    ],
)
def test_columns_and_rows_that_a_table_does_not_have_are_refused(
    tmp_path: Path, wanted: dict[str, Any], sentence: str
) -> None:
    with open_toy(tmp_path / "toy") as directory:
        fill(directory)
    with pytest.raises(TableError, match=sentence):
        load(tmp_path / "toy", **wanted)


def test_parts_of_different_versions_are_joined(tmp_path: Path) -> None:
    """Columns that only some have, other types, other categories, and text that is none."""
    frames = [block_frame(start, stop) for start, stop in ((0, 4), (4, 8), (8, 10))]
    names = pd.Categorical(["direct", "new", "direct", None], categories=["new", "direct"])
    frames[1] = frames[1].assign(cycles=np.arange(4) + 0.5, gait=names, speed=1.5, note="x", flag=True)
    frames[2] = frames[2].assign(gait=frames[2]["gait"].astype(object), count=3)
    with open_toy(tmp_path / "toy") as directory:
        for number, frame in enumerate(frames):
            directory.write_part(number, frame)
    table = load(tmp_path / "toy")
    assert table["cycles"].tolist() == [0, 1, 2, 3, 0.5, 1.5, 2.5, 3.5, 8, 9]
    assert list(table["gait"].cat.categories) == [*GAITS, "new"]
    messages = [str(gait) for frame in frames for gait in frame["gait"].astype(object).fillna("nan")]
    assert table["gait"].astype(object).fillna("nan").tolist() == messages
    for name, known in {"speed": [1.5] * 4, "note": ["x"] * 4, "flag": [True] * 4}.items():
        assert table[name][4:8].tolist() == known
        assert np.all(table[name].drop(range(4, 8)).isna())
    assert table["count"].dropna().tolist() == [3, 3]


def test_text_without_categories_is_joined_with_a_column_that_has_none(tmp_path: Path) -> None:
    """As earlier refined runs wrote the events of stalled rows, beside parts of inferred rows alone."""
    of_parts = [["b lands", None, None, "a"], pd.Categorical([None] * 4, ["a"]), pd.Categorical([None] * 2)]
    with open_toy(tmp_path / "toy") as directory:
        for number, stalled_by in enumerate(of_parts):
            frame = block_frame(*directory.layout.rows_of(number))
            directory.write_part(number, frame.assign(stalled_by=stalled_by))
    table = load(tmp_path / "toy")
    assert table["stalled_by"].dropna().tolist() == ["b lands", "a"]
    assert list(table["stalled_by"].cat.categories) == ["a", "b lands"]


def test_values_of_a_manifest_are_those_that_json_gives_back() -> None:
    numbers = [1, 2.5, "x", None, True]
    given = {"a": numbers, "b": (1, 2), "c": [np.float64(3), np.arange(2)], "d": {1: [(4,)]}, "e": [[0.5]]}
    plain = {"a": numbers, "b": [1, 2], "c": [3.0, [0, 1]], "d": {"1": [[4]]}, "e": [[0.5]]}
    assert repr(json_value(given)) == repr(plain)


def test_memory_contains_the_wanted_columns_and_one_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, block = 200_000, 10_000
    with open_toy(tmp_path / "toy", rows, block) as directory:
        fill(directory)
    held: list[int] = []  # bytes of Arrow's columns, after each part
    before = pa.total_allocated_bytes()
    # bytes of all columns of a part, with room for copies, and of the wanted ones of those before it
    a_part = 200 * block

    def read(*part: Any) -> pa.Table:
        table = parquet_parts.read_records(*part)
        waits = 0  # Arrow's threads let go of earlier parts some time after they were read
        while pa.total_allocated_bytes() - before >= a_part and waits < 200:
            time.sleep(0.01)
            waits += 1
        held.append(pa.total_allocated_bytes())
        return table

    monkeypatch.setattr(examination, "read_records", read)

    assert sum(len(part) for part in load_parts(tmp_path / "toy", ["row", "a", "gait"])) == rows
    assert max(held) - before < a_part

    held.clear()
    tracemalloc.start()
    table = load(tmp_path / "toy", ["a"])
    _, arrays = tracemalloc.get_traced_memory()  # NumPy's, into which Arrow's are copied
    tracemalloc.stop()
    assert len(table) == rows
    assert max(held) - before < a_part
    assert arrays < 8 * rows + a_part


def test_a_directory_without_parts_is_refused_by_load(tmp_path: Path) -> None:
    open_toy(tmp_path / "toy").close()
    with pytest.raises(TableError, match="no complete part yet"):
        load(tmp_path / "toy")
    with pytest.raises(TableError, match="does not exist"):
        load(tmp_path / "nothing")


def test_an_interrupted_table_ends_byte_for_byte_as_an_uninterrupted_one(tmp_path: Path) -> None:
    with open_toy(tmp_path / "whole", rows=50) as directory:
        fill(directory)
    with open_toy(tmp_path / "broken", rows=50) as directory:
        for number in (7, 1, 4):
            directory.write_part(number, block_frame(*directory.layout.rows_of(number)))
    with open_toy(tmp_path / "broken", rows=50) as directory:
        assert len(directory.missing_blocks()) == len(directory.layout.blocks) - 3
        fill(directory)
    assert files_of(tmp_path / "whole" / "table") == files_of(tmp_path / "broken" / "table")
    pd.testing.assert_frame_equal(load(tmp_path / "whole"), load(tmp_path / "broken"), check_exact=True)


def test_crossing_tables_count_rows_not_records(tmp_path: Path) -> None:
    frame = pd.DataFrame(
        {
            "row": np.array([0, 0, 0, 1, 2, 3], dtype=np.int64),
            "crossing": [1, 2, 3, 1, 0, 1],
            "status": ["complete", "complete", "complete", "fell", "fell", "complete"],
        }
    )
    with open_toy(tmp_path / "toy", rows=4) as directory:
        with pytest.raises(ValueError, match="count 3 rows, not 4"):
            directory.write_part(0, frame.loc[frame["row"] != 2])
        directory.write_part(0, frame)
        assert directory.counts() == {"complete": 2, "fell": 2}
    assert len(load(tmp_path / "toy")) == 6


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda frame: frame.drop(columns="status"), "needs the column status"),
        (lambda frame: frame.assign(row=frame["row"] + 1), "from 0 to 3"),
        (lambda frame: frame.iloc[::-1], "in order"),
        (lambda frame: frame.assign(row=frame["row"].astype(float)), "int64"),
        (lambda frame: frame.iloc[:3], "count 3 rows"),
    ],
)
def test_a_frame_of_other_rows_is_not_written(tmp_path: Path, change, sentence: str) -> None:
    with open_toy(tmp_path / "toy") as directory:
        with pytest.raises(ValueError, match=sentence):
            directory.write_part(0, change(block_frame(0, 4)))
        assert directory.missing_blocks() == [0, 1, 2]


def test_another_job_is_refused_with_both_hashes_and_nothing_changes(tmp_path: Path) -> None:
    with open_toy(tmp_path / "toy") as directory:
        fill(directory)
    before = files_of(tmp_path / "toy")
    with pytest.raises(TableError, match=r"abcabcabcabc.*ffffffffffff.*--out"):
        open_toy(tmp_path / "toy", job_hash="f" * 64)
    with pytest.raises(TableError, match="blocks of 5"):
        open_toy(tmp_path / "toy", block=5)
    assert files_of(tmp_path / "toy") == before


def test_foreign_places_are_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "job.yaml").write_text("name: precious")
    with pytest.raises(TableError, match=r"not gaitsweep's \(job.yaml\)"):
        open_toy(tmp_path / "mine")
    assert files_of(tmp_path / "mine") == {"job.yaml": b"name: precious"}
    (tmp_path / "file").write_text("")
    with pytest.raises(TableError, match="is a file"):
        open_toy(tmp_path / "file")
    with pytest.raises(TableError, match="cannot be created"):
        open_toy(tmp_path / "file" / "below")
    (tmp_path / "empty").mkdir()
    open_toy(tmp_path / "empty").close()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"format": 2}',
        '{"format": 1, "job_hash": "", "rows": 1, "block": 1}',
        '{"format": 99, "job_hash": "", "rows": 1, "block": 1}',
    ],
)
def test_a_broken_manifest_is_a_sentence(tmp_path: Path, text: str) -> None:
    open_toy(tmp_path / "toy").close()
    (tmp_path / "toy" / "manifest.json").write_text(text)
    with pytest.raises(TableError, match=r"\.$"):
        open_toy(tmp_path / "toy")
    with pytest.raises(TableError, match=r"\.$"):
        load(tmp_path / "toy")


def test_two_writers_at_once(tmp_path: Path) -> None:
    with open_toy(tmp_path / "toy"), pytest.raises(TableError, match=f"process {os.getpid()} on .*--out"):
        open_toy(tmp_path / "toy")
    open_toy(tmp_path / "toy").close()
    assert (tmp_path / "toy" / ".lock").read_text() == ""  # nothing of the machine's name stays


def test_a_directory_that_could_not_be_locked_is_free_in_the_same_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with pytest.raises(WriteError, match="the disk is full"):
            open_toy(tmp_path / "toy")
    with open_toy(tmp_path / "toy") as directory:
        fill(directory)


def test_a_file_that_two_write_at_once_is_whole(tmp_path: Path) -> None:
    """As the figures of two `plot`; the one that ends last is read."""
    file, inner = tmp_path / "figure.png", []

    def slowly(stream: BinaryIO) -> None:
        stream.write(b"first, ")
        replace_file(file, lambda other: other.write(b"second"))
        inner.append(file.read_bytes())
        stream.write(b"slowly")

    replace_file(file, slowly)
    assert (inner, file.read_bytes()) == ([b"second"], b"first, slowly")
    assert [each.name for each in tmp_path.iterdir()] == ["figure.png"]


def test_what_is_no_regular_file_is_refused_and_closed(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_bytes(b"12345")
    before = len(os.listdir("/dev/fd"))
    for name, most, why in (
        (".", None, "directory"),
        ("pipe", None, "regular"),
        ("file", 4, "than 4 bytes"),
        ("none", None, "such"),
    ):
        with pytest.raises(OSError, match=why):
            read_file(tmp_path / name, most)
    assert read_file(tmp_path / "file", 5) == b"12345"
    assert len(os.listdir("/dev/fd")) == before
    assert reason(OSError("Cannot open /Data/Run_A")) == "Cannot open /Data/Run_A"


def test_stray_temporaries_are_removed_by_the_next_run_alone(tmp_path: Path) -> None:
    with open_toy(tmp_path / "toy") as directory:
        directory.write_part(0, block_frame(0, 4))
    strays = [
        tmp_path / "toy" / name for name in (".manifest.json.partial", "table/.part-00001.parquet.partial")
    ]
    for stray in strays:
        stray.write_bytes(b"half")
    assert len(load(tmp_path / "toy")) == 4
    assert all(stray.exists() for stray in strays)
    open_toy(tmp_path / "toy").close()
    assert not any(stray.exists() for stray in strays)


def test_a_new_directory_survives_a_kill_at_any_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every call that changes the disk fails in turn, without any clean-up."""
    names = ("replace", "fsync")
    real = {name: getattr(os, name) for name in names}
    finished, stop_at = False, 0
    for stop_at in range(1, 30):
        calls = 0

        def dying(name: str, *arguments: object, stop_at: int = stop_at) -> object:
            nonlocal calls
            calls += 1
            if calls == stop_at:
                raise KeyboardInterrupt
            return real[name](*arguments)

        path = tmp_path / str(stop_at)
        for name in names:
            monkeypatch.setattr(os, name, lambda *arguments, name=name, dying=dying: dying(name, *arguments))
        monkeypatch.setattr(Path, "unlink", lambda *_arguments, **_options: None)
        try:
            with open_toy(path) as directory:
                fill(directory)
            finished = True
        except KeyboardInterrupt:
            finished = False
        monkeypatch.undo()
        with open_toy(path) as directory:
            fill(directory)
        assert len(load(path)) == 10
        assert not list(path.rglob("*.partial"))
        if finished:
            break
    assert finished
    assert stop_at > 10


def test_a_truncated_part_is_removed_and_made_anew(tmp_path: Path) -> None:
    with open_toy(tmp_path / "toy") as directory:
        fill(directory)
    whole = load(tmp_path / "toy")
    part = tmp_path / "toy" / "table" / "part-00001.parquet"
    for length in (0, 3, 200, part.stat().st_size - 1):
        part.write_bytes(part.read_bytes()[:length])
        with pytest.raises(TableError, match="damaged"):
            load(tmp_path / "toy")
        assert tuple(Snapshot.of(tmp_path / "toy").files.faults) == (1,)
        with open_toy(tmp_path / "toy") as directory:
            assert directory.missing_blocks() == [1]
            assert "part-00001.parquet was damaged" in directory.notes[0]
            fill(directory)
    pd.testing.assert_frame_equal(load(tmp_path / "toy"), whole, check_exact=True)


def test_a_part_of_another_table_is_refused_not_removed(tmp_path: Path) -> None:
    for name, job_hash in (("one", "a" * 64), ("two", "b" * 64)):
        with open_toy(tmp_path / name, job_hash=job_hash) as directory:
            directory.write_part(0, block_frame(0, 4))
    stranger = tmp_path / "one" / "table" / "part-00001.parquet"
    stranger.write_bytes((tmp_path / "two" / "table" / "part-00000.parquet").read_bytes())
    with pytest.raises(TableError, match="belongs to another job"):
        open_toy(tmp_path / "one", job_hash="a" * 64)
    assert stranger.exists()


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_leaves_no_half_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    def full(*_arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with open_toy(tmp_path / "toy") as directory:
        directory.write_part(0, block_frame(0, 4))
        monkeypatch.setattr(os, call, full)
        with pytest.raises(
            WriteError, match=r"Part 1 \(rows 4 to 7\).*the disk is full; 4 of 10 rows are safe"
        ):
            directory.write_part(1, block_frame(4, 8))
        with pytest.raises(WriteError, match="the disk is full"):
            directory.update_manifest(note="x")
        monkeypatch.undo()
        assert "note" not in json.loads((tmp_path / "toy" / "manifest.json").read_text())
        assert sorted(os.listdir(tmp_path / "toy" / "table")) == ["part-00000.parquet"]
        fill(directory)
    assert load(tmp_path / "toy").attrs["complete"]


def test_a_file_too_large_for_the_system_is_a_sentence(tmp_path: Path) -> None:
    """A real refusal by the kernel while parquet is being written, where a mount is not allowed."""
    with open_toy(tmp_path / "toy", rows=4000, block=2000) as directory:
        directory.write_part(0, block_frame(0, 2000))
        old = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, old[1]))
        try:
            with pytest.raises(WriteError, match="2000 of 4000 rows are safe"):
                directory.write_part(1, block_frame(2000, 4000))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, old)
        assert os.listdir(tmp_path / "toy" / "table") == ["part-00000.parquet"]


def test_a_really_full_disk(tmp_path: Path) -> None:
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(tmp_path)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small file system is not allowed here")
    try:
        with open_toy(tmp_path / "toy", rows=40_000, block=2000) as directory:
            with pytest.raises(WriteError, match="the disk is full"):
                fill(directory)
            done = directory.rows_done
        assert 0 < done < 40_000
        assert len(load(tmp_path / "toy")) == done
        assert not list((tmp_path / "toy").rglob("*.partial"))
        with open_toy(tmp_path / "toy", rows=40_000, block=2000) as directory:
            assert directory.rows_done == done
    finally:
        subprocess.run(["umount", "-l", str(tmp_path)], check=True)


def test_arrow_reads_memory_of_its_own() -> None:
    """Its threads may hold a part longer than Python lives, when memory of Python's aborts the process."""
    data = bytes(range(256))
    before = sys.getrefcount(data)
    reader = readable(data)
    assert sys.getrefcount(data) == before
    assert reader.read() == data


WRITER = textwrap.dedent("""
    import sys, time
    from pathlib import Path
    from tests.support.toy_directories import block_frame, open_toy
    with open_toy(Path(sys.argv[1]), rows=1000, block=10) as directory:
        print("ready", flush=True)
        for number in directory.missing_blocks():
            directory.write_part(number, block_frame(*directory.layout.rows_of(number)))
            directory.update_manifest(last=number)
    print("done", flush=True)
""")


@pytest.mark.slow
def test_a_killed_writer_keeps_all_written_parts(tmp_path: Path) -> None:
    """SIGKILL comes at moments that do not depend on the writer, until the table is complete."""
    root = Path(__file__).parents[2]
    path = tmp_path / "toy"
    finished = 0
    for attempt in range(10):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path)], cwd=root, stdout=subprocess.PIPE, text=True
        )
        assert writer.stdout is not None
        assert writer.stdout.readline() == "ready\n"
        if attempt < 2:
            time.sleep(0.02 + 0.14 * attempt)
            writer.send_signal(signal.SIGKILL)
        rest = writer.stdout.read()
        writer.wait()
        writer.stdout.close()
        with open_toy(path, rows=1000, block=10) as directory:
            assert not directory.notes
            assert directory.rows_done >= finished
            finished = directory.rows_done
        if rest == "done\n":
            break
    table = load(path)
    expected = pd.concat([block_frame(start, start + 10) for start in range(0, 1000, 10)])
    assert np.array_equal(table["psi_1_end"], expected["psi_1_end"])
    assert list(table["row"]) == list(range(1000))


def test_a_table_of_fig_4_stays_small(tmp_path: Path) -> None:
    """A table of 15 625 rows takes less than 5 MB."""
    with ResultDirectory.open(tmp_path / "toy", JOB, Layout("c" * 64, 15_625, 1024)) as directory:
        fill(directory)
    assert sum(file.stat().st_size for file in (tmp_path / "toy").rglob("*") if file.is_file()) < 5e6
    assert (
        pq.read_table(tmp_path / "toy" / "table" / "part-00000.parquet").schema.field("gait").type == "string"
    )
    assert len(load(tmp_path / "toy")) == 15_625
