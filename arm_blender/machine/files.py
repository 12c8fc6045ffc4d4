"""Files that are written whole or not at all: under a temporary name first, then renamed into place."""

import json
import os
import platform
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

from ..errors import OutputError

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows has no locks that end with their process.
    fcntl = None

UNFINISHED = ".unfinished-"
"""How the name of a temporary folder begins."""

_PART = re.compile(r"\..+\.(\d+)\.part(\.[^.]*)?")
"""The name of a temporary file, and in it the process that writes it."""

_DAY = 86_400.0
"""Seconds after which, without locks, what is unfinished will never be finished."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Gives a temporary path beside `path`, with its suffix; what was written there becomes `path` at the end.

    Leaving the block through an exception removes the temporary file and leaves an older `path` as it was.

    Raises:
        OutputError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}); choose another place or free some") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_json(path: Path, data: Any) -> None:
    """`data` as indented JSON in `path`, whole or not at all; paths as text.

    Raises:
        OutputError: the file cannot be written.
    """
    with whole_file(path) as temporary:
        text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False, default=os.fspath)
        temporary.write_text(text + "\n", encoding="utf-8")


def distinct(names: Iterable[str]) -> list[str]:
    """Names of files: a name that an earlier one has gets the first number that is free, as in cup, cup-2."""
    found: dict[str, None] = {}
    for wanted in names:
        name, copies = wanted, 1
        while name in found:
            copies += 1
            name = f"{wanted}-{copies}"
        found[name] = None
    return list(found)


@contextmanager
def staging(directory: Path) -> Iterator[Path]:
    """A temporary folder inside `directory`, gone at the end; and so is `directory`, if it was made for nothing.

    Inside, because only there a rename never crosses file systems: `directory` may be a mount point. What a killed
    process has left there is taken away first.

    Raises:
        OutputError: it cannot be written.
    """
    existed = directory.exists()
    stage = lock = None
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with _locked(directory):
            _clear(directory)
            stage = Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=directory))
            lock = _lock(stage)
        yield stage
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(f"{directory}: cannot be written ({reason}); free space or change --output") from error
    finally:
        if stage is not None:
            shutil.rmtree(stage, ignore_errors=True)
        if lock is not None:
            os.close(lock)
        if not existed and directory.is_dir() and not any(directory.iterdir()):
            directory.rmdir()


def replace_folder(folder: Path, made: Path, older: Path) -> None:
    """Puts `made` in the place of `folder`, which goes to `older` where it exists; all of one file system."""
    if folder.exists():
        os.rename(folder, older)
    try:
        os.rename(made, folder)
    except BaseException:  # An interruption between the two as well: the user's files go back to their place.
        if older.exists() and not folder.exists():
            os.rename(older, folder)
        raise


@contextmanager
def only_writer(directory: Path) -> Iterator[None]:
    """Nobody else is inside such a block for `directory`, which is made where it is missing.

    The lock ends with its process, even if that is killed. Where there are no locks the file `.writer` takes its place,
    and outlives a process that is killed: the error then says that it may be removed.

    Raises:
        OutputError: another process writes there, or the folder cannot be made.
    """
    release = _claim(directory)
    try:
        yield
    finally:
        release()


def _claim(directory: Path) -> Callable[[], None]:
    """Takes the lock of `only_writer`; what gives it back."""
    check_output(directory)
    mark = directory / ".writer"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        lock = _lock(directory)
        if lock is not None:
            return partial(os.close, lock)
        with mark.open("x", encoding="utf-8") as file:
            file.write(f"process {os.getpid()} of {platform.node()}\n")
    except BlockingIOError as error:
        raise OutputError(f"{directory}: another run writes here; wait for it, or choose another --output") from error
    except FileExistsError as error:
        line = f"{directory}: another run writes here ({mark.name} names it)"
        raise OutputError(f"{line}; wait for it, or remove {mark} if it has ended") from error
    except OSError as error:
        raise OutputError(f"{directory}: cannot be made ({error.strerror}); choose another --output") from error
    return partial(mark.unlink, missing_ok=True)


def clear_unfinished(directory: Path) -> None:
    """Takes away what killed processes have left half-done in `directory`; what others are writing now stays.

    The folder itself goes as well where nothing else is in it.
    """
    if not directory.is_dir():
        return
    with suppress(OSError):  # Not ours to write: whoever writes there will say so.
        with _locked(directory):
            cleared = _clear(directory)
        if cleared and not any(directory.iterdir()):
            directory.rmdir()


def _clear(directory: Path) -> bool:
    """Whether anything was left over in `directory`, and taken away."""
    cleared = False
    for path in list(directory.iterdir()):
        part = _PART.fullmatch(path.name)
        if path.name.startswith(UNFINISHED) and path.is_dir() and _is_abandoned(path):
            shutil.rmtree(path, ignore_errors=True)
            cleared = True
        elif part and path.is_file() and not _is_running(int(part[1]), path):
            path.unlink(missing_ok=True)
            cleared = True
    return cleared


@contextmanager
def _locked(directory: Path) -> Iterator[None]:
    """Nobody else makes or clears temporary folders in `directory` meanwhile, where the system has locks."""
    lock = _lock(directory, wait=True)
    try:
        yield
    finally:
        if lock is not None:
            os.close(lock)


def _lock(directory: Path, wait: bool = False) -> int | None:
    """A descriptor that holds the lock on a folder until it is closed, at the latest by the end of the process.

    None where there are no locks: on Windows, and in some network folders.

    Raises:
        BlockingIOError: another process has it, and we do not wait.
    """
    if fcntl is None:
        return None
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        os.close(descriptor)
        if isinstance(error, BlockingIOError):
            raise
        return None
    return descriptor


def _is_abandoned(stage: Path) -> bool:
    """Whether no process is at work in a temporary folder any more."""
    try:
        lock = _lock(stage)
    except OSError:  # Held by its process, or gone meanwhile.
        return False
    if lock is None:
        return _is_old(stage)
    os.close(lock)
    return True


def _is_running(process: int, path: Path) -> bool:
    """Whether the process that writes a temporary file still runs."""
    if sys.platform == "win32":  # There, asking by signal ends the process.
        return not _is_old(path)
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def _is_old(path: Path) -> bool:
    return time.time() - path.stat().st_mtime > _DAY


def check_output(directory: Path) -> None:
    """Makes sure, before any work starts, that `directory` can be made and written; leaves nothing behind.

    Raises:
        OutputError: it cannot; the line names the folder that is in the way.
    """
    nearest = directory.absolute()
    try:
        str(nearest).encode()  # The writers of pictures and Blender take no other names.
        while not nearest.exists() and nearest != nearest.parent:
            nearest = nearest.parent
        if not nearest.is_dir():
            raise OutputError(f"{nearest}: is a file, not a folder; choose another --output")
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except UnicodeEncodeError as error:
        raise OutputError(f"{nearest}: the name is no UTF-8; choose another --output") from error
    except OSError as error:
        raise OutputError(f"{nearest}: cannot be written ({error.strerror}); choose another --output") from error
