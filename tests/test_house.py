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
BLENDERS = {"bpy", "bpy_extras", "bmesh", "mathutils"}
RUNTIME = {"torch", "numpy", "xatlas", "trimesh", "fast_simplification", "safetensors", "OpenImageIO", "PIL"}
FLOORS: list[set[str]] = [  # Of arm_blender: a room knows itself and those on lower floors, not its neighbours.
    {"errors", "version", "progress"},
    {"knobs"},
    {"machine"},
    {"report"},
    {"graphics.borders", "graphics.cameras"},
    {"structures"},
    {"graphics"},
    {"graphics.raster", "graphics.surface", "graphics.light"},
    {"refinement"},
    {"uv"},
    {"light_check"},
    {"models"},
    {"models.paper", "models.small"},
    {"weight_files"},
    {"views"},
    {"photographs"},
    {"asset_record", "quality_levels"},
    {"config", "export"},
    {"networks"},
    {"pipeline"},
    {"run"},
    {"blender.compat", "blender.console", "blender.job", "blender.layout"},
    {"blender.asset", "blender.setup"},
    {"blender.input", "blender.materials", "blender.relight"},
    {"blender.generate"},
    {"commands"},
    {"__main__"},
    {"blender"},
    {"__init__"},
]
TRAINING_FLOORS: list[set[str]] = [
    {"training"},  # The modules at its root: losses, trainer, documents.
    {"rendering"},
    {"rasterized"},
    {"datasets"},
    {"stages", "evaluation.truth"},
    {"evaluation.scores"},
    {"evaluation.trials"},
    {"evaluation.tables"},
    {"evaluation"},
    {"studies"},
    {"__main__"},
]
MOST_MODULES = 20
"""In one room; a larger one is cut."""
MOST_AT_THE_ROOT = 12
"""Modules of arm_blender beside `__init__` and `__main__`: the story and its nouns."""
OPTIONAL = {
    "diffusers",
    "transformers",
    "ray",
    "webdataset",
    "psutil",
    "resource",
    "onnxruntime",
    "rembg",
    "pycolmap",
    "pillow_heif",
    "av",
}
"""Extras that a user may install; imported inside functions only."""


def syntax(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def module_name(path: Path) -> str:
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


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
            names = [f"{module}.{alias.name}" for alias in node.names]  # Which may be a module.
        found += [(name, id(node) not in deferred) for name in names]
    return found


def known(path: Path) -> set[str]:
    """The modules of ours that a module imports, whenever that is."""
    ours = {module_name(other) for other in MODULES}
    found = set()
    for imported, _ in imports(path):
        while imported and imported not in ours:  # `from package.module import name`: the name goes.
            imported = imported.rpartition(".")[0]
        found.add(imported)
    return found - {"", module_name(path)}


def floor(module: str) -> tuple[int, str]:
    """On which floor of its package a module stands, and in which room: the longest name there that begins its own."""
    package, _, rest = module.partition(".")
    floors = FLOORS if package == "arm_blender" else TRAINING_FLOORS
    rooms = {room: index for index, names in enumerate(floors) for room in names}
    name = rest or "__init__"
    while name and name not in rooms:
        name = name.rpartition(".")[0]
    if not name and package == "training" and "." not in rest:
        name = "training"
    assert name, f"{module}: give it a room"
    return rooms[name], name


@pytest.fixture(params=MODULES, ids=module_name)
def module(request) -> Path:
    return request.param


def test_the_packages_are_found():
    assert ROOT / "arm_blender" / "structures.py" in MODULES
    assert ROOT / "training" / "__main__.py" in MODULES


def test_imports_flow_one_way(module):
    name = module_name(module)
    package = name.partition(".")[0]
    for imported in known(module):
        if imported.partition(".")[0] != package:
            assert package == "training", f"{name} imports {imported}"
            continue
        (own, room), (other, neighbour) = floor(name), floor(imported)
        assert other < own or room == neighbour, f"{name} ({room}) imports {imported} ({neighbour})"


def test_no_import_goes_in_a_circle():
    graph = {module_name(path): known(path) for path in MODULES}
    order: list[str] = []
    while ready := [name for name in graph if name not in order and graph[name] <= {*order, name}]:
        order += ready
    assert not graph.keys() - order


def test_rooms_stay_small_enough_to_know():
    for folder in {path.parent for path in MODULES}:
        own = [path.stem for path in folder.glob("*.py") if path.stem != "__init__"]
        assert len(own) <= MOST_MODULES, f"{folder.relative_to(ROOT)}: {len(own)} modules"
    root = {path.stem for path in (ROOT / "arm_blender").glob("*.py")} - {"__init__", "__main__"}
    assert len(root) <= MOST_AT_THE_ROOT, sorted(root)


def test_only_blender_code_imports_bpy(module):
    relative = module.relative_to(ROOT)
    renders = relative.parts[0] == "training" and module.stem.endswith("_blender")
    at_home = relative.is_relative_to("arm_blender/blender") or renders
    for imported, _ in imports(module):
        assert at_home or imported.split(".")[0] not in BLENDERS, f"{relative}: {imported}"


def test_the_extension_needs_only_its_runtime_dependencies(module):
    name = module_name(module)
    for imported, at_import in imports(module):
        top = imported.split(".")[0]
        known = top in RUNTIME | BLENDERS | {"arm_blender"} or top in sys.stdlib_module_names
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


@pytest.mark.parametrize("document", ["extreme-cases.md", "robustness.md"])
def test_the_tables_of_cases_name_tests_that_are_there(document):
    named = set(re.findall(r"`(test_\w+)`", (ROOT / "docs" / document).read_text(encoding="utf-8")))
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
LIGHT += ["arm_blender.knobs", "arm_blender.asset_record"]  # Blender's main thread reads them.
LIGHT += ["arm_blender.machine.picture_files"]  # Choosing files is no reason to wait.
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
