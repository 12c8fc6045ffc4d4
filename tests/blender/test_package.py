"""The extension's zip: valid, complete, free of everything else, and at work once it is installed."""

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest

import arm_blender
from arm_blender.machine import library_install

bpy = pytest.importorskip("bpy")
from arm_blender.blender import cli  # noqa: E402

pytestmark = pytest.mark.blender

ROOT = Path(arm_blender.__file__).parents[1]
LIBRARY = "arm_test_library"
MANIFEST = ROOT / "blender_manifest.toml"


def test_the_manifest_keeps_the_rules_of_the_extensions_site():
    manifest = tomllib.loads(MANIFEST.read_text())
    assert "Blender" not in manifest["name"]
    assert manifest["blender_version_min"] == "4.2.0"
    assert all(len(why) <= 64 and not why.endswith(".") for why in manifest["permissions"].values())


def wheel(folder: Path) -> Path:
    """The wheel of a library that Blender has not got."""
    made = folder / f"{LIBRARY}-1.0-py3-none-any.whl"
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr(f"{LIBRARY}/__init__.py", "")
        archive.writestr(f"{LIBRARY}-1.0.dist-info/METADATA", f"Metadata-Version: 2.1\nName: {LIBRARY}\nVersion: 1.0\n")
        archive.writestr(f"{LIBRARY}-1.0.dist-info/RECORD", f"{LIBRARY}/__init__.py,,\n")
    return made


@pytest.fixture(scope="module")
def repository(tmp_path_factory) -> Path:
    """A folder with the zip for this platform and Python, one small wheel in it, and the index that serves it."""
    folder, output = tmp_path_factory.mktemp("build"), tmp_path_factory.mktemp("repository")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "tools"))
        import build_extension

        target = build_extension.Target(
            build_extension.this_platform(), f"{sys.version_info.major}.{sys.version_info.minor}"
        )
        build_extension.build(target, [wheel(folder)], folder / "sources", output)
        build_extension.blender_tool("server-generate", "--repo-dir", str(output))
        build_extension.blender_tool("validate", str(ROOT))
    return output


@pytest.fixture
def package(repository) -> Path:
    return next(repository.glob("*.zip"))


def test_the_index_serves_the_zip_to_the_blenders_that_can_run_it(repository, package):
    (entry,) = json.loads((repository / "index.json").read_text())["data"]
    assert entry["archive_url"] == f"./{package.name}" and entry["archive_size"] == package.stat().st_size
    assert (entry["id"], len(entry["platforms"])) == ("arm_blender", 1)
    assert entry["blender_version_min"] == "4.2.0"


def test_the_zip_holds_the_package_and_nothing_else(package):
    names = zipfile.ZipFile(package).namelist()
    assert {"arm_blender/__init__.py", "arm_blender/blender/generate/panel.py"} <= set(names)
    assert {n for n in names if not n.startswith("arm_blender/")} - {"LICENSE", "CREDITS.md"} == {
        "blender_manifest.toml",
        "__init__.py",
        f"wheels/{LIBRARY}-1.0-py3-none-any.whl",
    }
    assert not [n for n in names if "__pycache__" in n or n.endswith((".pyc", ".part"))]
    example = (ROOT / "arm_blender" / "examples" / "barrel").iterdir()
    assert {f"arm_blender/examples/barrel/{path.name}" for path in example} <= set(names)
    weights = (ROOT / "arm_blender" / "weights").glob("small.*.safetensors")
    assert {f"arm_blender/locks/{path.name}" for path in library_install.LOCKS.iterdir()} <= set(names)
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
from pathlib import Path
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
before = set(sys.modules)
bpy.ops.extensions.package_install_files(filepath={str(package)!r}, repo="user_default", enable_on_install=True)
heavy = set("torch numpy trimesh xatlas PIL OpenImageIO safetensors diffusers transformers".split())
added = {{name.partition(".")[0] for name in set(sys.modules) - before}}
assert not heavy & added, f"enabling imports {{heavy & added}}"
import {LIBRARY}
from bl_ext.user_default.arm_blender.arm_blender import blender
preferences = importlib.import_module(blender.__name__ + ".setup.stored")
assert preferences.preferences().threads == 0, "the preferences belong to the extension"
assert bpy.context.scene.arm.seed == 0
folder = importlib.import_module(blender.__name__ + ".setup.stored").user_folder("weights")
assert folder.parts[-2:] == ("arm_blender", "weights") and ".user" in folder.parts, folder
package = importlib.import_module(blender.__name__.rpartition(".")[0])
for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
assert not [name for name in sys.modules if name.split(".")[0] == "arm_blender"], "an import is not relative"
bpy.ops.preferences.addon_disable(module="bl_ext.user_default.arm_blender")
assert not hasattr(bpy.types.Scene, "arm")
repositories = [repository.module for repository in bpy.context.preferences.extensions.repos]
bpy.ops.extensions.package_uninstall(repo_index=repositories.index("user_default"), pkg_id="arm_blender")
left = [Path({LIBRARY}.__file__), *Path({str(tmp_path)!r}).glob("extensions/user_default/arm_blender/*")]
assert not [path for path in left if path.is_file()], left
print("works")
"""
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", source], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.stdout.strip().endswith("works"), done.stdout + done.stderr
