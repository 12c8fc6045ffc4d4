"""The rules of the house that a parser can hold: who imports whom, names, sizes."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = sorted([*(ROOT / "arm_blender").rglob("*.py"), *(ROOT / "training").rglob("*.py")])
RUNTIME = {"torch", "numpy", "xatlas", "trimesh", "fast_simplification", "safetensors", "OpenImageIO", "PIL"}
LAYERS = [  # A module imports from its own layer and from earlier ones.
    {
        "errors",
        "version",
        "machine",
        "progress",
        "structures",
        "graphics",
    },  # structures holds cameras, and graphics fills structures.
    {"models", "uv"},
    {"weight_files"},
    {"views"},
    {"config", "quality_levels", "report", "export"},
    {"networks"},
    {"pipeline", "run"},
    {"blender", "commands", "__main__", "__init__"},
]
OPTIONAL = {"diffusers", "transformers", "ray", "webdataset", "psutil", "resource", "onnxruntime", "rembg"}
"""Extras that a user may install; imported inside functions only."""


def syntax(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def module_name(path: Path) -> str:
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 2 else parts)


def imports(path: Path) -> list[tuple[str, bool]]:
    """Every imported module, absolute, and whether the import runs when the module is imported."""
    tree = syntax(path)
    deferred = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for inner in ast.walk(node)
    }
    package = list(path.relative_to(ROOT).parent.parts)
    found = []
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            # `from . import x` may name a module: with its name appended, its layer can be read off.
            names = [f"{module}.{alias.name}" for alias in node.names] if module.count(".") == 0 else [module]
        found += [(name, id(node) not in deferred) for name in names]
    return found


def layer(module: str) -> int:
    """Which layer of `arm_blender` a module belongs to."""
    part = (module.split(".") + ["__init__"])[1]
    if not ((ROOT / "arm_blender" / part).exists() or (ROOT / "arm_blender" / f"{part}.py").exists()):
        part = "__init__"  # `from arm_blender import __version__`: a name, not a module.
    places = [index for index, names in enumerate(LAYERS) if part in names]
    assert places, f"{module}: give it a layer"
    return places[0]


@pytest.fixture(params=MODULES, ids=module_name)
def module(request) -> Path:
    return request.param


def test_the_packages_are_found():
    assert ROOT / "arm_blender" / "structures.py" in MODULES
    assert ROOT / "training" / "__main__.py" in MODULES


def test_imports_flow_one_way(module):
    name = module_name(module)
    for imported, _ in imports(module):
        if name.startswith("arm_blender"):
            assert not imported.startswith("training"), f"{name} imports {imported}"
            if imported.startswith("arm_blender"):
                assert layer(imported) <= layer(name), f"{name} imports {imported}"


def test_only_blender_code_imports_bpy(module):
    relative = module.relative_to(ROOT)
    renders = relative.parts[0] == "training" and module.stem.endswith("_blender")
    at_home = relative.is_relative_to("arm_blender/blender") or renders
    for imported, _ in imports(module):
        assert at_home or imported.split(".")[0] not in {"bpy", "bmesh", "mathutils"}, f"{relative}: {imported}"


def test_the_extension_needs_only_its_runtime_dependencies(module):
    name = module_name(module)
    for imported, at_import in imports(module):
        top = imported.split(".")[0]
        known = top in RUNTIME | {"arm_blender", "bpy", "bmesh", "mathutils"} or top in sys.stdlib_module_names
        if name.startswith("arm_blender"):
            assert known or (top in OPTIONAL and not at_import), f"{name} imports {imported}"


def test_a_module_holds_one_concept(module):
    assert len(module.read_text(encoding="utf-8").splitlines()) <= 300
    assert module.stem not in {"utils", "helpers", "misc", "common", "util", "helper"}


def test_functions_stay_readable(module):
    for node in ast.walk(syntax(module)):
        if isinstance(node, ast.FunctionDef):
            assert node.end_lineno - node.lineno < 60, f"{node.name} has {node.end_lineno - node.lineno + 1} lines"


def test_no_error_is_swallowed(module):
    for node in ast.walk(syntax(module)):
        if isinstance(node, ast.ExceptHandler):
            assert node.type is not None, f"line {node.lineno}: a bare except"


def test_the_table_of_extreme_cases_names_tests_that_are_there():
    named = set(re.findall(r"`(test_\w+)`", (ROOT / "docs" / "extreme-cases.md").read_text(encoding="utf-8")))
    there = {
        node.name
        for path in (ROOT / "tests").rglob("test_*.py")
        for node in ast.walk(syntax(path))
        if isinstance(node, ast.FunctionDef)
    }
    assert len(named) > 30 and not named - there


def test_no_path_of_one_machine_is_written_down(module):
    text = module.read_text(encoding="utf-8")
    for place in ("/home/", "/root/", "/work/", "C:\\\\Users"):
        assert place not in text


LIGHT = ["arm_blender", "arm_blender.errors", "arm_blender.__main__", "training.__main__"]
LIGHT += ["arm_blender.machine.library_install", "arm_blender.weight_files.folder"]  # Blender's preferences use them.
LIGHT += ["arm_blender.commands.progress_line"]  # Shown before the seconds of importing torch are counted.


@pytest.mark.parametrize("package", LIGHT)
def test_importing_the_entry_points_is_light(package):
    code = (
        f"import sys, {package}\n"
        "heavy = {'torch', 'bpy', 'numpy', 'trimesh', 'xatlas', 'scipy'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=dict(os.environ, PYTHONPATH=str(ROOT)),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]"
