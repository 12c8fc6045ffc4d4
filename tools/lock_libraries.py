"""Writes the lists of pinned wheels with their hashes that the preferences' buttons install: arm_blender/locks/.

`python tools/lock_libraries.py`, after one of the versions below is changed. pip resolves and names the hashes; what
Blender or the extension's zip has already is left out. Standard library only.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from build_extension import BLENDERS, PLATFORMS, ROOT, WHEELS, Target, requirements

LOCKS = ROOT / "arm_blender" / "locks"

EXTRAS = {
    "torch-gpu": ("torch=={torch}",),
    "photos": ("pycolmap==4.2.1", "pillow-heif==1.8.1", "av==18.1.0"),
    "matting": ("onnxruntime==1.32.0",),
    "multiview": ("diffusers==0.42.1", "transformers==5.23.0", "onnxruntime==1.32.0"),
}
"""What each button asks pip for."""

# Windows: the registry's PyTorch is the one for the processor. macOS: the one in the zip drives the graphics device.
GPU_PLATFORMS = ("linux-x64",)

NUMPY = {"3.11": "numpy==1.26.4", "3.13": "numpy>=2"}
"""What Blender has of it, so that nothing is chosen that needs another."""

WINDOWS = ["colorama"]
"""What the libraries ask for there and nowhere else."""

BROUGHT = {"numpy", "torch", "pillow", "safetensors"}
"""Never in the lists of the other extras."""


def main() -> int:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    for extra in EXTRAS:
        for platform in GPU_PLATFORMS if extra == "torch-gpu" else PLATFORMS:
            for python in BLENDERS:
                path = write_lock(extra, Target(platform, python))
                print(f"{path}: {len(path.read_text().splitlines()) - 2} wheels", flush=True)
    return 0


def write_lock(extra: str, target: Target) -> Path:
    """Resolve an extra for a target, and write it as a file of requirements with hashes.

    Raises:
        subprocess.CalledProcessError: pip cannot resolve it; its own words stand on the standard error stream.
    """
    torch = requirements(Target("windows-x64", target.python))[1]["torch"]  # Without the "+cpu" of Linux.
    asked = [name.format(torch=torch) for name in EXTRAS[extra]] + [NUMPY[target.python]]
    if target.platform.startswith("windows"):
        asked += WINDOWS  # pip takes the requirements of the system that it runs on.
    brought = {"numpy"} if extra == "torch-gpu" else BROUGHT
    lines = {}
    for item in _report(asked, target)["install"]:
        name, version = item["metadata"]["name"].lower().replace("_", "-"), item["metadata"]["version"]
        if name not in brought:
            digest = item["download_info"]["archive_info"]["hashes"]["sha256"]
            lines[name] = f"{name}=={version} --hash=sha256:{digest}"
    head = [f"# {extra} for {target.platform}, Python {target.python}. Made by tools/lock_libraries.py."]
    head.append(f"# The versions asked for stand there and in tools/{WHEELS.name}.")
    path = LOCKS / f"{extra}-{target.tag}.txt"
    path.write_text("\n".join([*head, *(lines[name] for name in sorted(lines))]) + "\n", encoding="utf-8")
    return path


def _report(asked: list[str], target: Target) -> dict:
    """What pip would install for the target, as its report says."""
    with tempfile.TemporaryDirectory(prefix="arm-lock-") as folder:
        report = Path(folder, "report.json")
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--dry-run"]
        command += ["--ignore-installed", "--only-binary=:all:", "--implementation", "cp"]
        command += ["--python-version", target.python, "--target", folder, "--report", str(report)]
        for tag in PLATFORMS[target.platform]:
            command += ["--platform", tag]
        # A wheel of this machine's own has a hash that nobody else would find.
        environment = {name: value for name, value in os.environ.items() if name != "PIP_FIND_LINKS"}
        subprocess.run([*command, *asked], check=True, env=environment | {"PIP_CONFIG_FILE": os.devnull})
        return json.loads(report.read_text(encoding="utf-8"))


if __name__ == "__main__":
    sys.exit(main())
