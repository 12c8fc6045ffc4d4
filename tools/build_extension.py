"""Builds the extension's zips, one for each platform and Python, and the index of a repository that serves them.

`python tools/build_extension.py --output out/extension`. Wheels come from pip, zips and index from Blender's own tool,
which the `bpy` of the Python that runs this brings. Standard library only.
"""

import argparse
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WHEELS = ROOT / "tools" / "extension_wheels.toml"
SOURCES = ("__init__.py", "arm_blender", "LICENSE", "CREDITS.md")
"""What is built; [build] of the manifest takes from it what does not belong."""

PLATFORMS = {
    "linux-x64": tuple(f"manylinux_2_{minor}_x86_64" for minor in range(28, 4, -1)) + ("manylinux2014_x86_64",),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_14_0_arm64",),
}
"""Blender's name of a platform, and the tags of the wheels that run there."""

BLENDERS = {"3.11": ("4.2.0", "5.1.0"), "3.13": ("5.1.0", None)}
"""The Blender versions of each Python: from the first, and before the second."""


class BuildError(Exception):
    """One line that says what is wrong, and the remedy."""


@dataclass(frozen=True)
class Target:
    """One zip."""

    platform: str
    python: str

    @property
    def tag(self) -> str:
        return f"{self.platform}-cp{self.python.replace('.', '')}"


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "extension", metavar="DIR")
    parser.add_argument("--platform", nargs="+", default=[this_platform()], choices=PLATFORMS)
    parser.add_argument("--python", nargs="+", default=list(BLENDERS), choices=BLENDERS)
    parser.add_argument("--torch-index", metavar="URL", help="where pip has to find PyTorch, for Linux without CUDA")
    parser.add_argument("--without-torch", action="store_true", help="leave PyTorch out everywhere")
    args = parser.parse_args(argv)
    targets = [Target(platform, python) for platform in args.platform for python in args.python]
    try:
        args.output.mkdir(parents=True, exist_ok=True)
        for old in args.output.glob("arm_blender-*.zip"):  # The index would list it.
            old.unlink()
        for target in targets:
            with tempfile.TemporaryDirectory(prefix="arm-extension-") as folder:
                wheels, torch = collect(target, Path(folder, "wheels"), args.torch_index, not args.without_torch)
                package = build(target, wheels, Path(folder, "sources"), args.output)
            with_torch = "with PyTorch" if torch else "WITHOUT PyTorch"
            print(f"{package}: {package.stat().st_size / 1e6:.1f} MB, {len(wheels)} wheels, {with_torch}", flush=True)
        blender_tool("server-generate", "--repo-dir", str(args.output), "--html")
    except BuildError as error:
        print(f"extension: {error}", file=sys.stderr)
        return 1
    print(f"{args.output / 'index.json'}: the repository's index")
    return 0


def this_platform() -> str:
    """Blender's name of the platform that this runs on."""
    return {"win32": "windows-x64", "darwin": "macos-arm64"}.get(sys.platform, "linux-x64")


def requirements(target: Target) -> tuple[dict[str, str], dict[str, str]]:
    """Name to version: of the libraries that this zip carries, and of PyTorch with what it requires, PyTorch first."""
    pins = tomllib.loads(WHEELS.read_text(encoding="utf-8"))
    included = pins["included"][target.python]
    libraries = {name: version for name, version in pins["libraries"].items() if name not in included}
    # The build for Linux without a local version is that for CUDA: 3 GB with its libraries.
    local = "+cpu" if target.platform.startswith("linux") else ""
    torch = {name: version + local for name, version in pins["torch"].items()}
    return libraries, torch | pins["torch-requirements"]


def collect(target: Target, folder: Path, torch_index: str | None, with_torch: bool) -> tuple[list[Path], bool]:
    """Download the wheels of a target; returns them, and whether PyTorch is among them.

    Raises:
        BuildError: pip has not got a library, or failed; only PyTorch may be missing, where no index for it was named.
    """
    libraries, torch = requirements(target)
    _download(target, libraries, folder, None)
    if with_torch:
        first, *rest = torch
        # The libraries are there, so pip and the network do: PyTorch alone tells whether it can be had.
        try:
            _download(target, {first: torch[first]}, folder, torch_index)
        except BuildError as error:
            if torch_index is not None:
                raise
            with_torch = False
            print(f"{error}; --torch-index may name a place", file=sys.stderr)
        else:
            _download(target, {name: torch[name] for name in rest}, folder, torch_index)
    return sorted(folder.glob("*.whl")), with_torch


def _download(target: Target, pins: dict[str, str], folder: Path, index: str | None) -> None:
    """pip's own download of exactly these wheels, or of none.

    Raises:
        BuildError: there is no such wheel for the target, or pip failed.
    """
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"]
    command += ["--disable-pip-version-check", "--python-version", target.python, "--implementation", "cp"]
    for tag in PLATFORMS[target.platform]:
        command += ["--platform", tag]
    if index is not None:
        command += ["--extra-index-url", index]
    # The versions are chosen here: a user's constraints could only contradict them. An empty variable changes nothing.
    environment = os.environ | {"PIP_CONSTRAINT": os.devnull}
    with tempfile.TemporaryDirectory(prefix="arm-wheels-") as fresh:
        asked = [f"{name}=={version}" for name, version in pins.items()]
        done = subprocess.run([*command, "--dest", fresh, *asked], capture_output=True, text=True, env=environment)
        if done.returncode != 0:
            # "extension: torch==..." is of use, pip's warnings before it are not.
            line = next((line for line in done.stderr.splitlines()[::-1] if line.startswith("ERROR")), done.stderr)
            said = f"{target.tag}: pip: {line.removeprefix('ERROR: ').strip()}"
            raise BuildError(f"{said}; check the network and {WHEELS}")
        folder.mkdir(parents=True, exist_ok=True)
        for wheel in Path(fresh).glob("*.whl"):
            shutil.move(wheel, folder)


def build(target: Target, wheels: list[Path], stage: Path, output: Path) -> Path:
    """Lay sources and wheels out in `stage`, and let Blender's tool make and validate the zip.

    Raises:
        BuildError: the tool refuses them; its own words say why.
    """
    stage.mkdir(parents=True)
    for name in SOURCES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copyfile
        copy(ROOT / name, stage / name)
    (stage / "wheels").mkdir()
    for wheel in wheels:
        shutil.move(wheel, stage / "wheels")
    manifest = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    names = [wheel.name for wheel in wheels]
    (stage / "blender_manifest.toml").write_text(manifest_for(target, manifest, names), encoding="utf-8")
    version = tomllib.loads(manifest)["version"]
    package = output / f"arm_blender-{version}-{target.tag}.zip"
    blender_tool("build", "--source-dir", str(stage), "--output-filepath", str(package))
    blender_tool("validate", str(package))
    return package


def manifest_for(target: Target, manifest: str, wheels: list[str]) -> str:
    """The repository's manifest with platform, wheels, and the Blender versions that have the target's Python."""
    first, before = BLENDERS[target.python]
    lines = [f'blender_version_min = "{first}"']
    if before is not None:
        lines.append(f'blender_version_max = "{before}"')
    lines += [f'platforms = ["{target.platform}"]', "wheels = ["]
    lines += [f'  "./wheels/{wheel}",' for wheel in wheels] + ["]"]
    return re.sub(r"^blender_version_min = .*$", "\n".join(lines), manifest, count=1, flags=re.MULTILINE)


def blender_tool(*arguments: str) -> None:
    """Run Blender's `extension` command, which is a script of the standard library alone.

    Raises:
        BuildError: there is no bpy, or the command failed.
    """
    found = importlib.util.find_spec("bpy")
    scripts = sorted(Path(found.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")) if found else []
    if not scripts:
        raise BuildError(f"{sys.executable}: has no bpy, whose tool builds the zip; run make first")
    done = subprocess.run([sys.executable, str(scripts[0]), *arguments], capture_output=True, text=True)
    if done.returncode != 0:
        raise BuildError(f"{arguments[0]}: {' '.join((done.stdout + done.stderr).split())}")


if __name__ == "__main__":
    sys.exit(main())
