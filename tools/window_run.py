"""Runs the extension in a Blender with a window, measures it, and writes docs/user-interface.md: `make test-ui`.

Every scenario of tests/ui/drive_window.py has a Blender of its own. Status 1 where a bar is missed or one failed.
"""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path

import window_table
from build_extension import ROOT
from window_root import Failed, blender_version, inside, make

SCENARIOS = ("pictures", "example", "run", "cancel", "load", "quit", "disable", "engines")
SCENARIOS += ("photographs", "doubtful", "materials")
LIMIT = 1200.0
"""Seconds of one scenario; *cancel* begins a run for each of its stages, *photographs* solves cameras."""
BUTTONS = {"generate": [759, 436], "example": [759, 939]}
"""In pixels from the lower left of a window of 1100 x 1200: Generate with the views of the example listed, Example
without any."""
SIDEBAR = "258x1000+624+86"
VIEWPORT = "882x1000+0+86"
"""What is cut out of the pictures: the sidebar, and it with its 3D view."""
PICTURES = {
    "panel": (("idle", "running", "failed", "done"), SIDEBAR, ("-trim",)),
    "panel-example": (("example-nothing", "example-made"), VIEWPORT, ("-resize", "50%")),
    "panel-doubtful": (("doubtful",), SIDEBAR, ("-trim",)),
    "materials": (("materials-regions", "materials-predicted", "materials-chrome"), VIEWPORT, ("-resize", "50%")),
}
"""In docs/images: of what each is made, side by side, and how."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--root", type=Path, default=ROOT / ".cache" / "blender-window", help="made where it is not")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "ui", help="pictures, logs and numbers")
    parser.add_argument("--only", nargs="+", choices=SCENARIOS, default=SCENARIOS, help="others as found last")
    parser.add_argument(
        "--write", action="store_true", help="docs/user-interface.md and its pictures, of what is there"
    )
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    try:
        make(args.root)
        failed = False
        for name in args.only:
            started = time.monotonic()
            try:
                scenario(name, args.root, args.out)
                said = "done"
            except Failed as error:
                failed, said = True, f"FAILED: {error}"
            print(f"{name}: {said} ({time.monotonic() - started:.0f} s)", flush=True)
        found = {
            name: json.loads(path.read_text()) for name in SCENARIOS if (path := args.out / f"{name}.json").is_file()
        }
        checks = window_table.checks(found)
        print(window_table.table(checks))
        if args.write and {"run", "pictures"} <= found.keys():
            text = window_table.document(found, f"Blender {blender_version(args.root)}, {machine()}")
            (ROOT / "docs" / "user-interface.md").write_text(text, encoding="utf-8")
            compose(args.root, args.out)
    except Failed as error:
        print(error, file=sys.stderr)
        return 1
    return 1 if failed or any(not check.held for check in checks) else 0


def scenario(name: str, root: Path, out: Path) -> None:
    """Run one; what it finds is in OUT/NAME.json, which is missing where it failed.

    Raises:
        Failed: it, or its Blender, ended badly.
    """
    resources = root / "tmp" / "resources"
    shutil.rmtree(resources, ignore_errors=True)
    extensions = resources / "extensions" / "user_default"
    extensions.mkdir(parents=True)
    (extensions / "arm_blender").symlink_to("/mnt/project")
    (out / f"{name}.json").unlink(missing_ok=True)
    command = ["env", "BLENDER_USER_RESOURCES=/tmp/resources", f"ARM_BUTTONS={json.dumps(BUTTONS)}", "blender"]
    command += ["--factory-startup", "--enable-event-simulate", "--window-geometry", "0", "0", "1100", "1200"]
    command += ["--python", "/mnt/project/tests/ui/drive_window.py", "--", name]
    done = inside(root, out, command, LIMIT)
    (out / f"{name}.log").write_text(done.stdout, encoding="utf-8")
    if done.returncode != 0 or not (out / f"{name}.json").is_file():
        last = done.stdout.strip().splitlines()[-1:]
        (out / f"{name}.json").unlink(missing_ok=True)
        raise Failed(f"status {done.returncode}; {''.join(last)}; {out / name}.log says more")


def compose(root: Path, out: Path) -> None:
    """The `PICTURES` of which all parts are there."""
    for made, (names, cut, then) in PICTURES.items():
        if not all((out / f"{name}.png").is_file() for name in names):
            continue  # Found last by others, as the rest of the page.
        paths = [f"/mnt/out/{name}.png" for name in names]
        command = ["convert", *paths, "-crop", cut, "+repage", "+append", *then, f"/mnt/out/{made}.png"]
        done = inside(root, out, command, 60.0)
        if done.returncode != 0:
            raise Failed(f"ImageMagick: {done.stdout.strip()}")
        shutil.copy(out / f"{made}.png", ROOT / "docs" / "images" / f"{made}.png")


def machine() -> str:
    """Such as "Linux x86_64, 2 cores of ..."."""
    cpu = subprocess.run(["lscpu"], capture_output=True, text=True, errors="replace").stdout
    model = next((line.partition(":")[2].strip() for line in cpu.splitlines() if line.startswith("Model name")), "?")
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores ({model}), software OpenGL under Xvfb"


if __name__ == "__main__":
    sys.exit(main())
