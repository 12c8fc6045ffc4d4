"""What pycolmap does for us, as a program of its own: a crash in its native code, or a stop, takes nobody along.

Started by `runner.py` as a script, with the path of a job (JSON) and the search path for modules. Neither it nor what
it loads imports anything of this package: it must start where only pycolmap and numpy are found. Lines on stdout that
begin with `MARK` are JSON: progress, an answer, an error.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from pathlib import Path
from typing import Any

MARK = "\x1earm "
"""Begins each line that is meant for the parent: native code writes lines of its own."""

STEPS = {
    "match": "mapping",
    "map_pictures": "mapping",
    "map_again": "mapping",
    "ray_tables": "lenses",
    "read_model": "lenses",
}
"""Functions of a job and a way to tell something, and the file beside this one that has them."""


def main(job_path: str, search_path: str) -> None:
    """Do a job."""
    sys.path[:0] = search_path.split(os.pathsep)
    job = json.loads(Path(job_path).read_text(encoding="utf-8"))
    try:
        step = job["step"]
        spec = importlib.util.spec_from_file_location(STEPS[step], Path(__file__).with_name(f"{STEPS[step]}.py"))
        assert spec is not None and spec.loader is not None  # The file has a known suffix.
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        getattr(module, step)(job, _tell)
    except (RuntimeError, ValueError, KeyError, IndexError, OSError, ImportError) as error:
        _tell(error=f"{type(error).__name__}: {error}")
        _leave(1)
    _leave(0)


def _leave(status: int) -> None:
    """Native libraries that clear up at the end of a process have crashed there, with everything written."""
    sys.stdout.flush()
    os._exit(status)


def _tell(**words: Any) -> None:
    print(MARK + json.dumps(words), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
