"""The extension's zip: valid, complete, free of everything else, and at work once it is installed."""

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest

import arm_blender

bpy = pytest.importorskip("bpy")
from arm_blender.blender import cli  # noqa: E402

pytestmark = pytest.mark.blender

ROOT = Path(arm_blender.__file__).parents[1]
MANIFEST = ROOT / "blender_manifest.toml"


def test_the_manifest_keeps_the_rules_of_the_extensions_site():
    manifest = tomllib.loads(MANIFEST.read_text())
    assert "Blender" not in manifest["name"]
    assert manifest["blender_version_min"] == "4.2.0"
    assert all(len(why) <= 64 and not why.endswith(".") for why in manifest["permissions"].values())


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    """The extension's zip, built by Blender's own tool from the repository as it stands."""
    tool = Path(bpy.utils.resource_path("LOCAL"), "scripts", "addons_core", "bl_pkg", "cli", "blender_ext.py")
    out = tmp_path_factory.mktemp("package")
    for arguments in (["validate", str(ROOT)], ["build", "--source-dir", str(ROOT), "--output-dir", str(out)]):
        done = subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    return next(out.glob("*.zip"))


def test_the_zip_holds_the_package_and_nothing_else(package):
    names = zipfile.ZipFile(package).namelist()
    assert {"arm_blender/__init__.py", "arm_blender/blender/panels.py"} <= set(names)
    assert {n for n in names if not n.startswith("arm_blender/")} - {"LICENSE", "CREDITS.md"} == {
        "blender_manifest.toml",
        "__init__.py",
    }
    assert not [n for n in names if "__pycache__" in n or n.endswith((".pyc", ".part"))]
    weights = (ROOT / "arm_blender" / "weights").glob("small.*.safetensors")
    shipped = {f"arm_blender/weights/{path.name}" for path in weights}
    assert shipped <= set(names) and not [n for n in names if "weights/instantmesh" in n]


def test_the_command_downloads_only_where_blender_may_go_online(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr("arm_blender.__main__.main", lambda argv: asked.append(argv) or 0)
    for online in (True, False):
        monkeypatch.setattr(cli, "bpy", SimpleNamespace(app=SimpleNamespace(online_access=online)))
        assert cli.run(["weights", "--debug", "download", "matting"]) == (0 if online else 1)
        assert cli.run(["weights", "list"]) == 0
    assert len(asked) == 3 and "--online-mode" in capsys.readouterr().err


def test_the_zip_installs_and_every_module_finds_the_others(package, tmp_path):
    source = f"""
import importlib, pkgutil, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.extensions.package_install_files(filepath={str(package)!r}, repo="user_default", enable_on_install=True)
from bl_ext.user_default.arm_blender.arm_blender import blender
preferences = importlib.import_module(blender.__name__ + ".preferences")
assert preferences.preferences().threads == 0, "the preferences belong to the extension"
assert bpy.context.scene.arm.seed == 0
package = importlib.import_module(blender.__name__.rpartition(".")[0])
for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
assert not [name for name in sys.modules if name.split(".")[0] == "arm_blender"], "an import is not relative"
bpy.ops.preferences.addon_disable(module="bl_ext.user_default.arm_blender")
assert not hasattr(bpy.types.Scene, "arm")
print("works")
"""
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", source], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.stdout.strip().endswith("works"), done.stdout + done.stderr
