"""Makes sure of the system's libraries that bpy links and that no Python package brings. Standard library only.

Names the one apt line for what is missing; as root on a Debian it runs that line. Status 1 where something still is.
"""

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys

PACKAGES = {
    "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libSM.so.6": "libsm6",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libGL.so.1": "libgl1",
}
"""The Debian package of each library."""


def missing_packages() -> list[str]:
    """Debian packages that are not there, `venv` of this Python among them."""
    missing = [package for library, package in PACKAGES.items() if not _loads(library)]
    if importlib.util.find_spec("ensurepip") is None:  # Debian cuts it out of Python into a package of its own.
        missing.append(f"python{sys.version_info.major}.{sys.version_info.minor}-venv")
    return missing


def main() -> int:
    if not sys.platform.startswith("linux"):
        return 0
    missing = missing_packages()
    if not missing:
        return 0
    line = f"apt-get update && apt-get install -y --no-install-recommends {' '.join(missing)}"
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        print(f"system libraries are missing; run as root: {line}", file=sys.stderr)
        return 1
    print(f"system libraries are missing; running: {line}", file=sys.stderr)
    subprocess.run(line, shell=True, check=False)
    missing = missing_packages()
    if missing:
        print(f"still missing: {' '.join(missing)}; install them, then run make again", file=sys.stderr)
    return 1 if missing else 0


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
