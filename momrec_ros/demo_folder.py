"""The folder of the demo, which a later demo may replace, and nothing else."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from momrec_ros.files import new_folder

__all__ = ["replaced_folder"]

MANIFEST = "written_by_momrec_demo.txt"


@contextmanager
def replaced_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder to fill, which takes the place of an earlier demo's folder.

    Parameters
    ----------
    path : Path
        A new folder, or one that an earlier demo made and to which nothing was added since.

    Yields
    ------
    temporary : Path
        An empty folder beside it. When all went well, the list of its files is added, and the
        earlier folder is replaced; else the earlier folder stays.

    Raises
    ------
    FileExistsError
        If there is something of that name that no demo made, or that holds other files.
    """
    exists = os.path.lexists(path)
    if exists:
        _expect_untouched(path)
    token = secrets.token_hex(8)
    fresh, former = (path.with_name(f".{token}.{part}") for part in ("fresh", "former"))
    with new_folder(fresh) as temporary:
        yield temporary
        _write_manifest(temporary)
    if exists:
        path.rename(former)
    fresh.rename(path)
    shutil.rmtree(former, ignore_errors=True)


def _files(folder: Path) -> set[str]:
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_symlink() or not path.is_dir()
    }


def _write_manifest(folder: Path) -> None:
    lines = sorted(_files(folder))
    (folder / MANIFEST).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _expect_untouched(path: Path) -> None:
    manifest = path / MANIFEST
    if path.is_symlink() or not manifest.is_file():
        raise FileExistsError(f"Expected a new folder or that of an earlier demo, got {path}")
    listed = set(manifest.read_text(encoding="utf-8").splitlines())
    added = sorted(_files(path) - listed - {MANIFEST})
    if added:
        raise FileExistsError(
            f"Expected only the files of an earlier demo in {path}, got also {added[0]}"
        )
