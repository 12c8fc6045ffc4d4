"""Files that are written whole or not at all: under a temporary name first, then renamed into place."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .errors import OutputError


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
    """`data` as indented JSON in `path`, whole or not at all.

    Raises:
        OutputError: the file cannot be written.
    """
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


@contextmanager
def staging(directory: Path) -> Iterator[Path]:
    """A temporary folder inside `directory`, gone at the end; and so is `directory`, if it was made for nothing.

    Inside, because only there a rename never crosses file systems: `directory` may be a mount point.
    """
    existed = directory.exists()
    stage = None
    try:
        directory.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(prefix=".unfinished-", dir=directory))
        yield stage
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(f"{directory}: cannot be written ({reason}); free space or change --output") from error
    finally:
        if stage is not None:
            shutil.rmtree(stage, ignore_errors=True)
        if not existed and directory.is_dir() and not any(directory.iterdir()):
            directory.rmdir()


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
