"""Install libraries from the package index into a folder: pinned wheels whose hashes are known, all or none.

Runs pip in a process of its own, which can be stopped; standard library only, so that it works before PyTorch is there.
"""

import hashlib
import importlib.util
import logging
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import threading
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO

from ..errors import ArmError, OutputError
from ..progress import Progress
from .files import check_output, staging

logger = logging.getLogger(__name__)

LOCKS = Path(__file__).parents[1] / "locks"
"""Lists of pinned wheels: `<extra>-<platform>-cp<version>.txt`, made by tools/lock_libraries.py."""

_TICK = 0.2
"""Seconds between two reports, and until a stop is noticed."""
_DOWNLOADS = 0.8
"""Share of the progress bar; unpacking takes the rest."""
_MACHINES = {"x86_64": "x64", "amd64": "x64", "arm64": "arm64", "aarch64": "arm64"}
_SYSTEMS = {"linux": "linux", "darwin": "macos", "win32": "windows"}


def lock_of(extra: str) -> Path | None:
    """The list of `extra` for this platform and Python; None where there is none."""
    machine = platform.machine().lower()
    system = f"{_SYSTEMS.get(sys.platform, sys.platform)}-{_MACHINES.get(machine, machine)}"
    path = LOCKS / f"{extra}-{system}-cp{sys.version_info.major}{sys.version_info.minor}.txt"
    return path if path.is_file() else None


def folder_of(lock: Path, parent: Path) -> Path:
    """Where the libraries of a list lie: another list, another folder, so that none is replaced while it is in use."""
    return parent / f"{lock.stem}-{hashlib.sha256(lock.read_bytes()).hexdigest()[:8]}"


def install(lock: Path, parent: Path, progress: Progress, cache: Path | None = None) -> Path:
    """Download and unpack the wheels of a list; nothing is there unless all of them are, with the hashes of the list.

    Args:
        lock: requirements with hashes.
        parent: the folder is made in it; those of older lists of the same extra are removed.
        progress: told about five times a second; `Cancelled` from it ends pip at once.
        cache: where pip keeps what it downloaded; None for its own place.
    Returns:
        The folder, to be put on the search path.
    Raises:
        ArmError: there is no pip, or it failed: no network, no space, another hash.
        OutputError: the folder cannot be written.
    """
    check_output(parent)
    folder = folder_of(lock, parent)
    if folder.is_dir():
        return folder
    pip = _pip()
    count = sum("==" in line for line in lock.read_text(encoding="utf-8").splitlines())
    with staging(parent) as stage:
        command = [*pip, "install", "--no-deps", "--only-binary=:all:", "--require-hashes", "--no-compile"]
        command += ["--disable-pip-version-check", "--no-input", "--progress-bar", "off"]
        command += ["--target", str(stage / "libraries"), "--requirement", str(lock)]
        if cache is not None:
            command += ["--cache-dir", str(cache)]
        _run(command, count, progress)
        os.replace(stage / "libraries", folder)
    for old in parent.glob(f"{lock.stem}-*"):
        if old != folder:
            shutil.rmtree(old, ignore_errors=True)  # Windows keeps what is in use.
    progress(1.0, "Installed")
    return folder


def remove(lock: Path, parent: Path) -> None:
    """Delete what `install` made.

    Raises:
        OutputError: it is in use, or may not be deleted.
    """
    folder = folder_of(lock, parent)
    try:
        shutil.rmtree(folder)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be deleted ({error.strerror}); restart Blender and try again") from error


def _pip() -> list[str]:
    """How to start pip: Python's own, or the one that Python carries along to install it.

    Raises:
        ArmError: there is neither, as where a distribution took it out.
    """
    if importlib.util.find_spec("pip") is not None:
        return [sys.executable, "-I", "-m", "pip"]
    bundled = importlib.util.find_spec("ensurepip")
    if bundled is not None and bundled.origin is not None:
        places = [Path(bundled.origin).parent / "_bundled"]
        if shared := sysconfig.get_config_var("WHEEL_PKG_DIR"):  # Where distributions keep it.
            places.append(Path(shared))
        wheels = sorted(wheel for place in places for wheel in place.glob("pip-*.whl"))
        if wheels:
            return [sys.executable, "-I", str(wheels[0] / "pip")]
    raise ArmError(f"{sys.executable}: has no pip; install the libraries elsewhere, and name their folder instead")


def _run(command: list[str], count: int, progress: Progress) -> None:
    """Run pip to its end; its lines become progress, its last words an error.

    Args:
        count: wheels that it will name.
    """
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # No console window on Windows.
    )
    lines: SimpleQueue[str] = SimpleQueue()
    assert process.stdout is not None  # A pipe was asked for.
    reader = threading.Thread(target=_read, args=(process.stdout, lines), daemon=True)
    reader.start()
    done, message, log = 0, "Starting pip", []
    try:
        while reader.is_alive() or not lines.empty():
            progress(_DOWNLOADS * min(done / max(count, 1), 1.0), message)
            try:
                line = lines.get(timeout=_TICK).strip()
            except Empty:
                continue
            log.append(line)
            if line.startswith("Collecting "):
                done, message = done + 1, f"Downloading {line.split()[1].replace('==', ' ')}"
            elif line.startswith("Installing "):
                done, message = count, "Unpacking"
    finally:
        if process.poll() is None and reader.is_alive():
            process.kill()
        process.wait()
        reader.join()
        process.stdout.close()
    if process.returncode != 0:
        logger.error("%s", "\n".join(log))
        raise ArmError(f"pip: {_reason(log)}; see the console, or name a folder that holds the libraries")


def _read(stream: IO[str], lines: SimpleQueue[str]) -> None:
    for line in stream:
        lines.put(line)


def _reason(log: list[str]) -> str:
    """The one line of pip's output that says what went wrong."""
    errors = [line.removeprefix("ERROR: ") for line in log if line.startswith("ERROR: ")]
    if any("DO NOT MATCH" in line for line in errors):
        return "a downloaded file has not the hash that it should have; nothing was installed"
    return (errors or log or ["it ended without a word"])[-1].rstrip(".")
