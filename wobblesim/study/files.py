"""Files that are whole or not there: written aside, flushed to the disk, moved to their place, known by their hash."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import socket
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from wobblesim.study.errors import StoreError, first_line, not_written, reason
from wobblesim.study.schema import encodings

Buffer = bytes | memoryview | pa.Buffer


class FileRecord(NamedTuple):
    """A file of a dataset as the manifest knows it.

    Attributes
    ----------
    path : str
        Relative to the folder of the results.
    rows, bytes : int
    sha256 : str
        Of the whole file, in hexadecimal.
    """

    path: str
    rows: int
    bytes: int
    sha256: str


# --- the disk ------------------------------------------------------------------------------------------------------


def flush(path: Path) -> None:
    """Have the system put a file, or the names in a folder, on the disk (fsync)."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def make_folder(folder: Path) -> None:
    """Make a folder whose name survives a power cut."""
    if not folder.is_dir():
        make_folder(folder.parent)
        try:
            folder.mkdir(exist_ok=True)
        except FileExistsError:
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder)) from None
        with contextlib.suppress(PermissionError):  # who may write to a folder may not be allowed to list it
            flush(folder.parent)


def move_all(moves: Iterable[tuple[Path, Path]]) -> None:
    """Move whole files to their places; their names are on the disk when this returns.

    Raises
    ------
    WriteError
        If the system refuses: no space, no permission, no folder.
    """
    folders = {}
    for source, target in moves:
        try:
            if target.parent not in folders:
                make_folder(target.parent)
                folders[target.parent] = target
            source.replace(target)
        except OSError as error:
            raise not_written(target, error) from error
    for folder, target in folders.items():
        try:
            flush(folder)
        except OSError as error:
            raise not_written(target, error) from error


def write_flushed(path: Path, content: Buffer, told: Path | None = None) -> None:
    """Write a file and have it on the disk; what was begun of it is taken back if that fails.

    Parameters
    ----------
    path : Path
    content : bytes or the like
    told : Path, optional
        What to call it if that fails.

    Raises
    ------
    WriteError
        If the system refuses: no space, no permission, no folder.
    """
    try:
        with path.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        raise not_written(told or path, error, memoryview(content).nbytes) from error


def write_atomically(path: Path, scratch: Path, content: Buffer) -> None:
    """Write a file aside and move it to `path`: there is the whole new file or what was there before.

    Raises
    ------
    WriteError
        If the system refuses: no space, no permission, no folder.
    """
    temporary = scratch / f"{path.name}.{socket.gethostname()}.{os.getpid()}"
    write_flushed(temporary, content, told=path)
    move_all([(temporary, path)])


def write_whole(path: Path, content: Buffer) -> None:
    """Write a file where a user wants it, and make its folder: there is the whole new file or what was there before.

    Raises
    ------
    WriteError
        If the system refuses: no space, no permission, no folder.
    """
    try:
        make_folder(path.absolute().parent)
    except OSError as error:
        raise not_written(path, error) from error
    write_atomically(path, path.parent, content)


# --- tables --------------------------------------------------------------------------------------------------------


def write_table(path: Path, table: pa.Table, about: Mapping[str, str]) -> tuple[int, str]:
    """Write a Parquet file, have it on the disk, and return its length in bytes and its sha256.

    Parameters
    ----------
    path : Path
    table : pa.Table
    about : mapping of str to str
        Goes to the metadata of the file, as ``wobblesim.<name>``; the name of the ``table`` is among it.

    Raises
    ------
    WriteError
        If the system refuses.
    """
    sink = pa.BufferOutputStream()
    packing = _packing(about)
    if table.num_rows == 1:  # pages of one value: zstd makes none smaller, and took 1.8 ms of 6.6 ms a run
        packing |= {"compression": "none", "compression_level": None}
    pq.write_table(table.replace_schema_metadata(_metadata(about)), sink, **packing)
    content = sink.getvalue()
    write_flushed(path, content)
    return content.size, hashlib.sha256(content).hexdigest()


@contextmanager
def table_writer(path: Path, schema: pa.Schema, about: Mapping[str, str]) -> Iterator[pq.ParquetWriter]:
    """Write a Parquet file piece by piece, otherwise as `write_table` does; it is on the disk in the end.

    Raises
    ------
    WriteError
        If the system refuses.
    """
    try:
        with path.open("wb") as file:
            with pq.ParquetWriter(file, schema.with_metadata(_metadata(about)), **_packing(about)) as writer:
                yield writer
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        raise not_written(path, error) from error


def _metadata(about: Mapping[str, str]) -> dict[str, str]:
    return {f"wobblesim.{name}": value for name, value in about.items()}


def _packing(about: Mapping[str, str]) -> dict[str, Any]:
    return {"compression": "zstd", "compression_level": 3, "write_page_checksum": True, **encodings(about["table"])}


def damage(folder: Path, file: FileRecord) -> str | None:
    """What is wrong with a file, in words; None if it is, bit for bit, what was written."""
    try:
        with (folder / file.path).open("rb") as stream:
            length = os.fstat(stream.fileno()).st_size
            if length != file.bytes:
                return f"has {length:,} bytes instead of {file.bytes:,}"
            if hashlib.file_digest(stream, "sha256").hexdigest() != file.sha256:
                return "is altered: its content is not what was written (sha256)"
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read: {reason(error)}"
    return None


def read_tables(folder: Path, files: Sequence[FileRecord], columns: Sequence[str] | None = None) -> pa.Table:
    """Read files of one table, those columns only; what is read is, bit for bit, what was written.

    Rows come by condition, in the order of the files, then by seed, epoch and slot.

    Raises
    ------
    StoreError
        If a file is missing, cut or altered, or of an older version.
    """
    by_condition = groupby(files, key=lambda file: file.path.rpartition("/")[0])
    parts = [_read_condition(folder, list(mine), columns) for _, mine in by_condition]
    whole = _joined(folder, parts)
    if lacking := [name for name in columns or () if name not in whole.column_names]:
        raise StoreError(f"{folder} is of an older version: its tables have no {', '.join(lacking)}")
    return whole


def _joined(folder: Path, parts: Sequence[pa.Table]) -> pa.Table:
    try:
        # Robots of different sizes have genotypes of different lengths: as lists they fit into one column.
        return pa.concat_tables(parts, promote_options="default")
    except pa.ArrowException as error:
        raise StoreError(f"the files of {folder} are not of one version: {first_line(error)}") from error


def _read_condition(folder: Path, files: Sequence[FileRecord], columns: Sequence[str] | None) -> pa.Table:
    """The files of a condition, its rows by seed, if runs in a file of their own lie between those of another."""
    key = ["seed"] if columns and "seed" not in columns and len(files) > 1 else []
    parts = [_read(folder, file, [*columns, *key] if columns else None) for file in files]
    if len(parts) == 1:
        return parts[0]
    whole = _joined(folder, parts)
    seed = whole["seed"].to_numpy() if "seed" in whole.column_names else np.zeros(0)
    if (np.diff(seed) < 0).any():
        whole = whole.take(np.argsort(seed, kind="stable"))
    return whole.drop_columns(key)


def _read(folder: Path, file: FileRecord, columns: Sequence[str] | None) -> pa.Table:
    path = folder / file.path
    try:
        with pa.memory_map(str(path)) as content:
            # The hash covers what the checksums of the pages leave out: their headers and the footer. A flipped bit
            # there may be a wrong number, or a crash of the reader, instead of an error.
            if content.size() != file.bytes or hashlib.sha256(content.read_buffer()).hexdigest() != file.sha256:
                raise OSError("its content is not what was written")
            content.seek(0)
            parquet = pq.ParquetFile(content, page_checksum_verification=True)
            return parquet.read(columns=columns).replace_schema_metadata(None)
    except (OSError, UnicodeDecodeError, pa.ArrowException) as error:
        raise StoreError(
            f"{path} is missing or damaged ({first_line(error)}); `wobblesim verify --repair {folder}` puts all such "
            "files aside, and the sweep command, given again, computes their runs anew"
        ) from error


def read_about(path: Path) -> dict[str, str]:
    """The metadata of a file, as given to `write_table`.

    Raises
    ------
    StoreError
        If it is no file of ours.
    """
    try:
        return about_of(path, pq.read_metadata(path))
    except (OSError, pa.ArrowException) as error:
        raise StoreError(f"{path} cannot be read as Parquet: {first_line(error)}") from error


def about_of(path: Path, footer: pq.FileMetaData) -> dict[str, str]:
    """As `read_about`, of a file whose footer is read already."""
    metadata = footer.metadata or {}
    try:
        told = {name.decode(): value.decode() for name, value in metadata.items() if name.startswith(b"wobblesim.")}
    except UnicodeDecodeError as error:
        raise StoreError(f"{path} says of itself what is no text: it is damaged") from error
    if not told:
        raise StoreError(f"{path} was not written by wobblesim; give a file of a results folder")
    return {name.removeprefix("wobblesim."): value for name, value in told.items()}
