"""A Debian with a real Blender and a screen without a monitor, in a folder of its own, for `make test-ui`.

debootstrap fills the folder once, from the mirror that this machine already uses, and programs run inside it under
chroot: nothing is installed on the machine itself, and nothing stays mounted. Root rights on a Linux are needed.
Standard library only.
"""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from build_extension import ROOT

RELEASE = "trixie"
"""Blender 4.3.2 on Python 3.13; the newest release of Debian that has PyTorch beside it."""

PACKAGES = (
    *("blender", "xvfb", "xauth", "libgl1-mesa-dri", "libegl-mesa0", "imagemagick", "procps", "ca-certificates"),
    *("python3-torch", "libopenblas0-pthread", "python3-numpy", "python3-requests", "python3-zstandard"),
    *("python3-safetensors", "python3-trimesh", "python3-openimageio"),
)
"""Without OpenBLAS, Debian's PyTorch multiplies matrices with the reference BLAS, many times slower."""

WHEELS = ("pillow", "fast-simplification", "xatlas", "pycolmap")
"""What Debian lacks, or has too old, as pinned in requirements.txt and requirements-dev.txt."""

PYTHON = "3.13"
SITE = Path("usr/local/lib/python3.13/dist-packages")

_INSIDE = (
    "D=$1; shift; mount --make-rprivate /; for m in proc dev sys; do mount --bind /$m $D/$m; done; "
    "mount -t tmpfs tmpfs $D/dev/shm; mkdir -p $D/mnt/project $D/mnt/out; mount --bind $1 $D/mnt/project; shift; "
    'mount --bind $1 $D/mnt/out; shift; exec chroot $D "$@"'
)
"""The mounts live in a namespace that ends with the command. /mnt/project is the project, /mnt/out the results."""


class Failed(Exception):
    """A step did not do; one line."""


def make(folder: Path) -> None:
    """Fill `folder`, if it is not: 3 GB.

    Raises:
        Failed: no root rights, debootstrap is missing, or a step failed; the line says what to do.
    """
    if os.geteuid() != 0 or not sys.platform.startswith("linux"):
        raise Failed("a window needs a Linux and root rights (chroot, unshare); run make test-ui as root")
    if not (folder / ".whole").is_file():
        _fill(folder)
    _bring_wheels(folder)


def _fill(folder: Path) -> None:
    if shutil.which("debootstrap") is None:
        raise Failed("debootstrap: missing; apt-get install debootstrap")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    print(f"{folder}: being filled with Debian {RELEASE} and Blender; this takes minutes", flush=True)
    _run(["debootstrap", "--variant=minbase", RELEASE, folder, *_mirror()])
    shutil.copy("/etc/resolv.conf", folder / "etc")
    chroot = ["chroot", folder, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq"]
    _run([*chroot, "install", "-y", "--no-install-recommends", *PACKAGES])
    (folder / ".whole").touch()


def _bring_wheels(folder: Path) -> None:
    """Install what is pinned, unless it is there already."""
    files = [ROOT / name for name in ("requirements.txt", "requirements-dev.txt")]
    pins = [line for file in files for line in file.read_text(encoding="utf-8").splitlines()]
    wheels = [pin for pin in pins if pin.partition("==")[0] in WHEELS]
    mark = folder / ".wheels"
    if mark.is_file() and mark.read_text(encoding="utf-8").split() == wheels:
        return
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--only-binary=:all:", "--upgrade"]
    _run([*pip, "--python-version", PYTHON, "--implementation", "cp", "--target", folder / SITE, *wheels])
    mark.write_text("\n".join(wheels), encoding="utf-8")


def inside(folder: Path, out: Path, command: list[str], seconds: float) -> subprocess.CompletedProcess:
    """Run a command in there, with the project read as /mnt/project and `out` written as /mnt/out; on a screen.

    Raises:
        Failed: it did not end within `seconds`.
    """
    screen = ["xvfb-run", "-a", "-s", "-screen 0 1100x1200x24", "env", "LIBGL_ALWAYS_SOFTWARE=1", *command]
    words = ["unshare", "-m", "bash", "-c", _INSIDE, "_", folder, ROOT, out, *screen]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "errors": "replace"}
    with subprocess.Popen([str(word) for word in words], start_new_session=True, **pipes) as process:
        try:
            said = process.communicate(timeout=seconds)[0]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # The screen and Blender with it.
            said = process.communicate()[0]
            raise Failed(f"{' '.join(command)}: did not end within {seconds:.0f} s\n{said[-2000:]}") from None
    return subprocess.CompletedProcess(words, process.returncode, said, "")


def blender_version(folder: Path) -> str:
    """Such as 4.3.2."""
    done = subprocess.run(["chroot", folder, "blender", "--version"], capture_output=True, text=True, errors="replace")
    return done.stdout.split()[1]


def _mirror() -> list[str]:
    """The mirror in this machine's own lists; debootstrap's own choice where it has none."""
    lists = [Path("/etc/apt/sources.list"), *Path("/etc/apt/sources.list.d").glob("*")]
    for path in lists:
        for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
            words = line.split()
            if words[:1] in (["URIs:"], ["deb"]):
                found = [word for word in words if "://" in word and word.rstrip("/").endswith("/debian")]
                if found:
                    return found[:1]
    return []


def _run(command: list) -> None:
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, errors="replace")
    if done.returncode != 0:
        print(done.stdout[-3000:], done.stderr[-3000:], sep="\n", file=sys.stderr)
        raise Failed(f"{' '.join(words[:4])} ...: status {done.returncode}")
