"""The life of the extension from its zip, in a Python of its own with Blender as a module and nothing else of ours.

`python installed_extension.py ZIP VIEWS OUTPUT [--torch bundled|none|FOLDER] [--leave-enabled]`, with a fresh folder
as BLENDER_USER_RESOURCES. `tools/blender_matrix.py` runs it for every supported Blender; a failed step ends in its
traceback.
"""

import argparse
import importlib
import math
import sys
from pathlib import Path

import bpy

MODULE = "bl_ext.user_default.arm_blender"
LIBRARIES = ("xatlas", "trimesh", "fast_simplification", "safetensors", "PIL")
HEAVY = {"torch", "numpy", "trimesh", "xatlas", "PIL", "OpenImageIO", "safetensors", "diffusers", "transformers"}


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("package", "views", "output"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--torch", default="bundled", help="bundled, none, or a folder that holds it")
    parser.add_argument("--leave-enabled", action="store_true")
    args = parser.parse_args()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    install(args.package)
    if args.torch == "bundled":
        come_from_the_zip(("torch", *LIBRARIES))
    else:
        come_from_the_zip(LIBRARIES)
        say_what_is_missing(args.views)
    if args.torch not in ("bundled", "none"):
        preferences = bpy.context.preferences.addons[MODULE].preferences
        preferences.pytorch_source, preferences.pytorch_folder = "FOLDER", args.torch
    if not args.leave_enabled:
        if args.torch != "none":
            assert part("blender.setup.runtime").problem() == ""
            generate(args.views)
            relight(args.output)
            export(args.output)
        disable_and_uninstall()
    print("lived")


def install(package: Path) -> None:
    before = set(sys.modules)
    bpy.ops.extensions.package_install_files(filepath=str(package), repo="user_default", enable_on_install=True)
    assert bpy.context.scene.arm.preset == "small"
    # Blender reads every wheel's name with the standard library; none of the libraries is wanted yet.
    added = {name.partition(".")[0] for name in set(sys.modules) - before}
    assert not HEAVY & added, f"enabling imports {HEAVY & added}"


def part(name: str):
    return importlib.import_module(f"{MODULE}.arm_blender.{name}")


def say_what_is_missing(views: Path) -> None:
    assert "PyTorch is missing" in part("blender.setup.runtime").problem()
    try:
        bpy.ops.arm.generate(filepath=str(views))
    except RuntimeError as error:
        assert "PyTorch is missing" in str(error) and "Preferences" in str(error)
    else:
        raise AssertionError("generating without PyTorch succeeds")
    assert part("blender.cli").run(["doctor"]) == 1
    assert len(bpy.data.objects) == 0


def come_from_the_zip(names: tuple[str, ...]) -> None:
    local = Path(bpy.utils.user_resource("EXTENSIONS"), ".local")
    for name in names:
        found = Path(importlib.util.find_spec(name).origin)
        assert found.is_relative_to(local), f"{name} comes from {found}"
    assert not list(local.glob("**/site-packages/numpy")), "the zip brings a numpy"


def generate(views: Path) -> None:
    bpy.context.scene.arm.quality = "draft"
    assert bpy.ops.arm.generate(filepath=str(views)) == {"FINISHED"}
    made = bpy.context.object
    assert 100 <= len(made.data.polygons) <= 5000 and made.data.uv_layers
    shader = next(node for node in made.data.materials[0].node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    assert shader.inputs["Base Color"].is_linked
    assert part("blender.cli").run(["doctor"]) == 0


def relight(output: Path) -> None:
    pictures = part("blender.relight.renders")
    config = pictures.RelightConfig(resolution=64, samples=4)
    (picture,) = pictures.relight(bpy.context.object, ["studio"], output, config)
    pixels = list(bpy.data.images.load(str(picture)).pixels)
    alpha, red = pixels[3::4], pixels[0::4]
    assert 0.05 < sum(alpha) / len(alpha) < 0.95, "the object fills a part of the picture"
    assert sum(red) > 0.0 and all(map(math.isfinite, pixels))


def export(output: Path) -> None:
    made = bpy.context.object
    name, faces = made.name, len(made.data.polygons)
    assert bpy.ops.arm.export(directory=str(output), formats={"glb", "usd", "usdz", "obj"}) == {"FINISHED"}
    (target,) = output.rglob("*.glb")
    assert {".usda", ".usdz", ".obj", ".mtl"} <= {path.suffix for path in target.parent.iterdir()}
    bpy.ops.wm.read_factory_settings(use_empty=True)  # The extension goes with the preferences.
    bpy.ops.import_scene.gltf(filepath=str(target))
    (mesh,) = bpy.data.meshes
    assert len(mesh.polygons) == faces and mesh.materials[0].name.startswith(name)
    bpy.ops.preferences.addon_enable(module=MODULE)


def disable_and_uninstall() -> None:
    bpy.ops.preferences.addon_disable(module=MODULE)
    assert not hasattr(bpy.types.Scene, "arm") and not hasattr(bpy.types, "ARM_OT_generate")
    bpy.ops.preferences.addon_enable(module=MODULE)
    assert hasattr(bpy.types.Scene, "arm")
    repositories = [repository.module for repository in bpy.context.preferences.extensions.repos]
    bpy.ops.extensions.package_uninstall(repo_index=repositories.index("user_default"), pkg_id="arm_blender")
    assert not hasattr(bpy.types.Scene, "arm")
    folder = Path(bpy.utils.user_resource("EXTENSIONS"))
    assert not (folder / "user_default" / "arm_blender" / "__init__.py").exists()
    assert not list(folder.glob(".local/**/site-packages/xatlas")), "the libraries stay behind"


if __name__ == "__main__":
    main()
