"""Damaged, edited and hostile result directories: an error message, never a wrong table or a traceback."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from gaitsweep.cli.main import main
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.figures import draw_figures
from gaitsweep.table import ResultDirectory, Snapshot, TableError, load
from gaitsweep.table.digests import read_digests
from gaitsweep.table.manifest import sealed
from gaitsweep.view.report import write_report
from tests.support.toy_directories import block_frame, files_of, fill, open_toy

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    path = tmp_path / "toy"
    with open_toy(path) as directory:
        fill(directory)
        directory.update_manifest(complete=True, counts=directory.counts(), quantities={})
    return path


def part(path: Path, number: int) -> Path:
    """Return the file of a part."""
    return path / "table" / f"part-{number:05d}.parquet"


def mended(path: Path) -> list[str]:
    """Open a directory as a run does, write its missing parts, and return its notes."""
    with open_toy(path) as directory:
        fill(directory)
        return directory.notes


def test_no_flipped_bit_of_a_part_is_read(whole: Path) -> None:
    expected = load(whole)
    random = np.random.default_rng(1)
    file = part(whole, 1)
    data = file.read_bytes()
    for _ in range(150):
        broken = bytearray(data)
        broken[random.integers(len(data))] ^= 1 << int(random.integers(8))
        file.write_bytes(broken)
        # with a flip in the job's hash in its footer, it is a part of another job
        with pytest.raises(TableError, match=r"part-00001\.parquet is (damaged|not a part of this table)"):
            load(whole)
    assert any("part-00001.parquet was damaged" in note for note in mended(whole))
    pd.testing.assert_frame_equal(load(whole), expected, check_exact=True)


def test_pages_carry_checksums(whole: Path) -> None:
    """Readers of parquet that do not know `SHA256SUMS` detect a changed page too."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    data = bytearray(part(whole, 0).read_bytes())
    column = pq.read_metadata(part(whole, 0)).row_group(0).column(4)
    data[column.data_page_offset + column.total_compressed_size - 1] ^= 1
    with pytest.raises((OSError, pa.ArrowException)):
        pq.ParquetFile(pa.BufferReader(bytes(data)), page_checksum_verification=True).read()


def test_exchanged_parts_are_named_and_written_again(whole: Path) -> None:
    expected = load(whole)
    first, second = part(whole, 0).read_bytes(), part(whole, 1).read_bytes()
    part(whole, 0).write_bytes(second)
    part(whole, 1).write_bytes(first)
    with pytest.raises(TableError, match=r"part-00000.*part 1 instead of 0.*part-00001"):
        load(whole)
    assert len(mended(whole)) == 2
    pd.testing.assert_frame_equal(load(whole), expected, check_exact=True)


def test_a_part_of_another_job_is_set_aside(whole: Path, tmp_path: Path) -> None:
    expected = load(whole)
    with open_toy(tmp_path / "other", job_hash="b" * 60) as directory:
        fill(directory)
    stranger = part(tmp_path / "other", 0).read_bytes()
    part(whole, 0).write_bytes(stranger)
    with pytest.raises(TableError, match="not a part of this table: it belongs to another job"):
        load(whole)
    assert "foreign" in mended(whole)[0]
    pd.testing.assert_frame_equal(load(whole), expected, check_exact=True)
    assert (whole / "table" / "part-00000.parquet.foreign").read_bytes() == stranger


@pytest.mark.parametrize("name", ["part-000001.parquet", "part-00009.parquet", "copy of part-00000.parquet"])
def test_no_part_is_read_twice_or_beside_the_table(whole: Path, name: str) -> None:
    shutil.copy(part(whole, 0), whole / "table" / name)
    with pytest.raises(TableError, match=f"{name} is not a part of this table"):
        load(whole)
    with pytest.raises(TableError, match="ove it out"):
        open_toy(whole)


def test_a_folder_or_a_pipe_in_place_of_a_part(whole: Path) -> None:
    expected = load(whole)
    for number, make in enumerate((Path.mkdir, os.mkfifo)):
        part(whole, number).unlink()
        make(part(whole, number))
        with pytest.raises(TableError, match=f"part-0000{number}.parquet"):
            load(whole)
    mended(whole)
    pd.testing.assert_frame_equal(load(whole), expected, check_exact=True)
    part(whole, 2).unlink()
    part(whole, 2).mkdir()
    (part(whole, 2) / "mine").write_text("precious")
    with pytest.raises(TableError, match="is a folder"):
        open_toy(whole)
    assert (part(whole, 2) / "mine").exists()


def test_an_edited_manifest_is_refused_and_rewritten(whole: Path) -> None:
    file = whole / "manifest.json"
    good = file.read_text()
    for old, new in (('"rows": 10', '"rows": 8'), ('"complete": true', '"complete": false'), ("{", "[")):
        assert old in good
        file.write_text(good.replace(old, new, 1))
        with pytest.raises(TableError, match=r"manifest\.json"):
            load(whole)
        note = mended(whole)[0]
        assert "it will be rewritten" in note
        assert "run the job" not in note, "it is being run"
        assert len(load(whole)) == 10
        file.write_text(good)


@pytest.mark.parametrize("lost", [("SHA256SUMS",), ("manifest.json",), ("SHA256SUMS", "manifest.json")])
def test_without_manifest_or_digests_no_row_is_run_again(whole: Path, lost: tuple[str, ...]) -> None:
    expected, parts = load(whole), [file.stat().st_ino for file in sorted((whole / "table").iterdir())]
    for name in lost:
        (whole / name).unlink()
    if "manifest.json" in lost:
        with pytest.raises(TableError, match=r"manifest\.json of .* is missing"):
            load(whole)
    else:
        with pytest.warns(UserWarning, match="3 files of the table have no digests"):
            pd.testing.assert_frame_equal(load(whole), expected, check_exact=True)
    notes = mended(whole)
    assert [file.stat().st_ino for file in sorted((whole / "table").iterdir())] == parts
    assert all(any(word in note for note in notes) for word in lost)
    assert not mended(whole)
    pd.testing.assert_frame_equal(load(whole), expected, check_exact=True)


def test_a_part_without_digest_is_kept_only_if_its_pages_are_sound(whole: Path) -> None:
    import pyarrow.parquet as pq

    expected = load(whole)
    lines = (whole / "SHA256SUMS").read_text().splitlines(keepends=True)
    (whole / "SHA256SUMS").write_text("".join(line for line in lines if "part-0000" not in line))
    data = bytearray(part(whole, 1).read_bytes())
    column = pq.read_metadata(part(whole, 1)).row_group(0).column(4)
    data[column.data_page_offset + column.total_compressed_size - 1] ^= 1
    part(whole, 1).write_bytes(data)
    part(whole, 0).write_bytes(part(whole, 2).read_bytes())
    with pytest.raises(TableError, match=r"part-00000.*part-00001"):
        load(whole, columns=["a"])
    notes = mended(whole)
    assert [name for name in ("part-00000", "part-00001", "part-00002") if name in "".join(notes)] == [
        "part-00000",
        "part-00001",
    ]
    assert "1 file of" in notes[-1]
    pd.testing.assert_frame_equal(load(whole), expected, check_exact=True)


def test_a_folder_of_another_program_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine" / "table").mkdir(parents=True)
    (tmp_path / "mine" / "table" / "precious.txt").write_text("")
    with pytest.raises(TableError, match="choose another directory"):
        open_toy(tmp_path / "mine")
    with open_toy(tmp_path / "other", job_hash="b" * 60) as directory:
        fill(directory)
    (tmp_path / "other" / "manifest.json").unlink()
    before = files_of(tmp_path)
    with pytest.raises(TableError, match="choose another directory"):
        open_toy(tmp_path / "other")
    assert files_of(tmp_path) == before


def test_a_file_beside_the_table_is_read_only_as_it_was_written(whole: Path) -> None:
    with open_toy(whole) as directory:
        directory.write_beside("best.parquet", b"12345")
        directory.tidy_digests()
        assert directory.read_beside("best.parquet") == b"12345"
        for other in (b"12346", b"", b"123456"):
            (whole / "best.parquet").write_bytes(other)
            assert directory.read_beside("best.parquet") is None
        (whole / "best.parquet").write_bytes(b"12345")
        (whole / "SHA256SUMS").unlink()
        assert directory.read_beside("best.parquet") is None
        assert len(directory.notes) == 4
        (whole / "best.parquet").unlink()
        assert directory.read_beside("best.parquet") is None
        assert len(directory.notes) == 4


ODD = [None, True, 0, -1, 1e308, float("nan"), 10**40, "text", [], {}, [1], {"foo": 1}, {"foo": []}, [[[{}]]]]


@pytest.mark.parametrize(
    "name", ["timings", "quantities", "counts", "gaits", "job", "rows", "block", "format"]
)
def test_odd_fields_of_an_unsealed_or_sealed_manifest(whole: Path, name: str) -> None:
    """With a correct seal, as an attacker could write it, and in format 1, which has no seal."""
    file = whole / "manifest.json"
    good = json.loads(file.read_text())
    for value in ODD:
        for form in (1, 2):
            manifest = {**good, "format": form, name: value}
            file.write_text(json.dumps(sealed(manifest)))
            for read in (load, Snapshot.of, write_report, draw_figures):
                with contextlib.suppress(TableError):
                    read(whole)
    file.write_text("[" * 100_000)
    with pytest.raises(TableError, match="not JSON"):
        load(whole)


def test_attrs_come_from_the_manifest(whole: Path) -> None:
    file = whole / "job.yaml"
    job = yaml.safe_load(file.read_text())
    file.write_text(yaml.safe_dump({**job, "model": "another", "vary": {"a": [7.0]}}))
    with pytest.warns(UserWarning, match="job.yaml was changed"):
        table = load(whole)
    assert table.attrs["job"] == job
    for drawn in ({"style": {"width": "column"}}, {"figures": [{"kind": "basin", "x": "a", "y": "b"}]}):
        file.write_text(yaml.safe_dump({**job, **drawn, "name": "new"}))  # which decide no number
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            load(whole)
    mended(whole)
    assert yaml.safe_load(file.read_text()) == job


GARBAGE = [
    b"\x00\xff\xfe garbage",
    b"figures: hello",
    b"figures: [{kind: basin, x: 3, y: []}]",
    b"figures: [{kind: nothing}]",
    b"figures: [{}]",
    b"figures: [{kind: basin, x: a, y: a, name: ../../outside}]",
    b"figures: [{kind: basin, x: a, y: a, name: /tmp/outside}]",
    b"run: hello",
    b"- a list",
    b"a: &a [*a]",
    b"2024-99-99: 1",
    b"[" * 5000,
    b"name: [",
]


@pytest.mark.parametrize("text", GARBAGE)
def test_a_job_file_of_garbage(whole: Path, text: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    (whole / "job.yaml").write_bytes(text)
    before = files_of(whole.parent)
    assert main(["plot", str(whole)]) == 2
    printed = capsys.readouterr().err
    assert "job.yaml" in printed
    assert "Traceback" not in printed
    assert files_of(whole.parent).keys() == before.keys()
    for command in ("info", "report"):
        assert main([command, str(whole)]) in (0, 2)


@pytest.mark.parametrize(
    "name", ["manifest.json", "job.yaml", "SHA256SUMS", "table", "figures", "report.html", ".lock"]
)
@pytest.mark.parametrize("what", ["folder", "file", "pipe", "gone", "link"])
def test_other_things_where_files_belong(
    whole: Path, name: str, what: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = whole / name
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    outside = tmp_path / "outside"
    if what == "folder":
        path.mkdir()
        (path / "mine").write_text("")
    elif what == "file":
        path.write_text("")
    elif what == "pipe":
        os.mkfifo(path)
    elif what == "link":
        outside.write_text("precious")
        path.symlink_to(outside)
    for command in ("info", "report", "plot"):
        assert main([command, str(whole)]) in (0, 2)
    assert "Traceback" not in capsys.readouterr().err
    with contextlib.suppress(TableError):
        mended(whole)
    if what == "link":
        assert outside.read_text() == "precious"


def test_links_at_the_names_of_temporaries_are_not_followed(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_text("precious")
    with open_toy(tmp_path / "toy") as directory:
        for name in (
            "table/.part-00000.parquet.partial",
            "table/part-00000.parquet",
            ".manifest.json.partial",
        ):
            (tmp_path / "toy" / name).symlink_to(outside)
        fill(directory)
        directory.update_manifest(note="x")
    assert outside.read_text() == "precious"
    assert len(load(tmp_path / "toy")) == 10


def test_digests_are_those_of_sha256sum(whole: Path) -> None:
    if shutil.which("sha256sum") is None:
        pytest.skip("sha256sum is not installed")
    done = subprocess.run(["sha256sum", "-c", "SHA256SUMS"], cwd=whole, capture_output=True, check=True)
    assert done.stdout.count(b"OK") == 4


def test_rewritten_files_have_one_digest(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So `sha256sum -c` accepts the directory; a kill before the old line is removed is harmless."""
    with open_toy(whole) as directory:
        directory.write_beside("best.parquet", b"12345")
    before = read_digests(whole)
    with monkeypatch.context() as killed:
        killed.setattr("gaitsweep.table.directory.write_digests", lambda *_: sys.exit(1))
        with open_toy(whole) as directory, pytest.raises(SystemExit):
            directory.write_beside("best.parquet", b"67")
    lines = (whole / "SHA256SUMS").read_text().splitlines()
    assert len(lines) == len(before) + 1
    with open_toy(whole) as directory:
        assert directory.read_beside("best.parquet") == b"67"
        directory.write_beside("best.parquet", b"8")
        assert directory.read_beside("best.parquet") == b"8"
    names = [line.partition("  ")[2] for line in (whole / "SHA256SUMS").read_text().splitlines()]
    assert sorted(names) == sorted(before)
    (whole / "job.yaml").write_text("name: edited\n")
    mended(whole)
    names = [line.partition("  ")[2] for line in (whole / "SHA256SUMS").read_text().splitlines()]
    assert sorted(names) == sorted(before)
    assert read_digests(whole) | {"best.parquet": ""} == before | {"best.parquet": ""}


def test_a_kill_between_the_digest_and_the_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A digest without its part and an incomplete line are not damage."""
    path = tmp_path / "toy"
    with open_toy(path) as directory:
        directory.write_part(0, block_frame(0, 4))
        with open(path / "SHA256SUMS", "a") as file:
            file.write(f"{'0' * 64}  table/part-00001.parquet\n{'1' * 30}")
        fill(directory)
        assert not directory.notes
    assert load(path).attrs["complete"]
    with open_toy(path) as directory:
        assert not directory.notes
        directory.tidy_digests()
    assert load(path).attrs["complete"]


def test_an_incomplete_table_is_reported(tmp_path: Path) -> None:
    with open_toy(tmp_path / "toy") as directory:
        directory.write_part(0, block_frame(0, 4))
        keep(directory, [5, 9])
    with pytest.warns(UserWarning, match=r"6 of 10 rows are missing \(2 of them have ended"):
        table = load(tmp_path / "toy")
    assert list(table["row"]) == [0, 1, 2, 3]
    assert (table.attrs["complete"], table.attrs["rows_missing"], table.attrs["rows_open"]) == (False, 6, 2)


def keep(directory: ResultDirectory, rows: list[int]) -> None:
    """Store rows with as many samples as their number."""
    row = np.array(rows, np.int64)
    samples = np.concatenate([np.full((n, 3), n + 0.1) for n in rows])
    last = np.where(row[:, None] % 2, np.nan, -0.0) * np.ones(2)
    directory.keep(RowOutcome(row, {"status": row.astype(np.int32), "last": last}, row, samples))


def test_rows_of_open_blocks_are_restored_to_the_bit(tmp_path: Path) -> None:
    path = tmp_path / "toy"
    with open_toy(path) as directory:
        keep(directory, [1, 5, 2])
        keep(directory, [0, 5])
    with open_toy(path) as directory:
        assert directory.rows_open == 4
        first, second = directory.restored(0), directory.restored(1)
        assert first is not None
        assert second is not None
        assert directory.restored(2) is None
        np.testing.assert_array_equal(first.row, [0, 1, 2])
        np.testing.assert_array_equal(first.samples, np.repeat([1.1, 2.1, 2.1], 3).reshape(3, 3))
        np.testing.assert_array_equal(second.samples, np.full((5, 3), 5.1))
        assert first.status.dtype == np.int32
        assert np.signbit(first.last[0]).all()
        assert np.isnan(first.last[1]).all()
        directory.write_part(0, block_frame(0, 4))
        assert len(list(path.glob("table/open-*"))) == 2  # row 5 is in both
        directory.write_part(1, block_frame(4, 8))
        assert not list(path.glob("table/open-*"))


def test_rows_of_a_version_with_fewer_numbers_leave_the_others_whole(tmp_path: Path) -> None:
    with open_toy(tmp_path / "toy") as directory:
        row = np.array([0])
        directory.keep(RowOutcome(row, {"status": row.astype(np.int32)}, row, np.zeros((0, 3))))
        keep(directory, [1, 2])
    with open_toy(tmp_path / "toy") as directory:
        restored = directory.restored(0)
        assert restored is not None
        assert restored.row.tolist() == [1, 2]
        assert restored.numbers.keys() == {"status", "last"}


def test_damaged_rows_of_open_blocks_are_run_again(tmp_path: Path) -> None:
    path = tmp_path / "toy"
    with open_toy(path) as directory:
        directory.write_part(0, block_frame(0, 4))
        keep(directory, [5])
        keep(directory, [6])
    lines = (path / "SHA256SUMS").read_text()
    (path / "SHA256SUMS").unlink()
    with open_toy(path) as directory:
        assert directory.rows_open == 2
    assert sorted((path / "SHA256SUMS").read_text().splitlines()) == sorted(set(lines.splitlines()))
    file = path / "table" / "open-00001.parquet"
    file.write_bytes(file.read_bytes()[:-9])
    assert len(Snapshot.of(path).files.open_faults) == 1
    assert Snapshot.of(path).rows_open == 1
    with open_toy(path) as directory:
        assert "open-00001.parquet was damaged" in directory.notes[0]
        assert directory.rows_open == 1
        fill(directory)
    assert load(path).attrs["complete"]


@pytest.mark.slow
def test_damages_of_real_tables() -> None:
    line = [sys.executable, "-m", "benchmarks.reliability.damage", "--trials", "40"]
    subprocess.run(line, cwd=ROOT, check=True, timeout=900)


@pytest.mark.slow
def test_kills_of_working_runs() -> None:
    kinds = ("settle", "refine", "continuation")
    line = [sys.executable, "-m", "benchmarks.reliability.kills", "--kills", "2", "--kinds", *kinds]
    subprocess.run(line, cwd=ROOT, check=True, timeout=1800)
