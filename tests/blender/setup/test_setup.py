"""The preferences: libraries from three places, buttons that need the network, the list of weights, what is missing."""

import os
import sys
import types
from pathlib import Path

import pytest

import arm_blender
from arm_blender.machine import libraries, library_install
from arm_blender.weight_files import checkpoints
from arm_blender.weight_files import folder as weights_folder
from arm_blender.weight_files import install as weights_install

bpy = pytest.importorskip("bpy")
from arm_blender.blender.generate import matting_operator  # noqa: E402
from arm_blender.blender.setup import background, runtime  # noqa: E402
from arm_blender.blender.setup import operators as setup_operators  # noqa: E402
from arm_blender.blender.setup import panel as setup_layout  # noqa: E402
from arm_blender.errors import ArmError, OutputError  # noqa: E402

pytestmark = pytest.mark.blender


@pytest.fixture
def chosen(empty_file, tmp_path, monkeypatch):
    """The preferences of the extension, as where it is enabled; its own folders lie in `tmp_path`."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    for module in (runtime, setup_operators, setup_layout):
        monkeypatch.setattr(module, "user_folder", lambda kind: tmp_path / kind)
    addon = bpy.context.preferences.addons.new()
    addon.module = "arm_blender"
    arm_blender.register()
    yield addon.preferences
    arm_blender.unregister()
    bpy.context.preferences.addons.remove(addon)


@pytest.fixture
def online(chosen):
    """Blender as where online access is allowed; the command line's Blender is offline."""
    app = types.SimpleNamespace(online_access=True, background=True)
    with pytest.MonkeyPatch.context() as patch:  # Undone before the extension is unregistered.
        patch.setattr(setup_operators, "bpy", types.SimpleNamespace(app=app, path=bpy.path, types=bpy.types))
        yield


@pytest.fixture
def lock(tmp_path, monkeypatch) -> Path:
    """The list of PyTorch, as where there is one for this platform; of nothing else."""
    made = tmp_path / "extra.txt"
    made.write_text("arm-one==1.0\n")
    for module in (runtime, setup_layout, library_install):
        monkeypatch.setattr(module, "lock_of", lambda extra: made if extra == runtime.TORCH else None)
    return made


def torch_in(folder: Path) -> Path:
    (folder / "torch").mkdir(parents=True)
    return folder


def without(monkeypatch, *packages: str) -> None:
    monkeypatch.setattr(libraries, "missing", lambda asked: [package for package in asked if package in packages])


class Layout:
    """Plays a layout of Blender: keeps what is shown, and looks up what it is asked to show."""

    def __init__(self):
        self.lines, self.operators, self.properties, self.fractions = [], [], [], []

    def box(self):
        return self

    def row(self, align=False):
        return self

    column = row

    def label(self, text, icon="NONE"):
        assert icon in bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items
        self.lines.append(text)

    @property
    def texts(self):
        """All that is shown, whatever lines it stands in."""
        return " ".join(self.lines)

    def prop(self, owner, name):
        assert name in owner.bl_rna.properties
        self.properties.append(name)

    def operator(self, name, text="", icon="NONE"):
        group, _, rest = name.partition(".")
        getattr(getattr(bpy.ops, group), rest).get_rna_type()  # Raises where there is no such operator.
        self.operators.append(name)
        return types.SimpleNamespace()

    def progress(self, factor, text):
        self.fractions.append((factor, text))


def drawn(chosen) -> Layout:
    layout = Layout()
    setup_layout.draw_setup(layout, chosen)
    return layout


def test_without_pytorch_the_extension_says_what_to_do(chosen, monkeypatch, tmp_path):
    without(monkeypatch, "torch")
    assert "PyTorch is missing" in drawn(chosen).texts
    for operator in (lambda: bpy.ops.arm.generate(filepath=str(tmp_path)), bpy.ops.arm.list_weights):
        with pytest.raises(RuntimeError, match="PyTorch is missing; Edit > Preferences > Add-ons"):
            operator()


def test_other_libraries_that_are_missing_are_named(chosen, monkeypatch):
    without(monkeypatch, "xatlas", "trimesh")
    with pytest.raises(ArmError, match=r"xatlas, trimesh: missing; install the extension's zip that was made for"):
        runtime.prepare()


def test_a_folder_that_holds_pytorch_takes_the_place_of_the_bundled_one(chosen, monkeypatch, tmp_path):
    without(monkeypatch, "torch")
    chosen.pytorch_source, chosen.pytorch_folder = "FOLDER", str(torch_in(tmp_path / "own"))
    runtime.prepare()
    assert sys.path[0] == str(tmp_path / "own")
    chosen.pytorch_source = "BUNDLED"
    runtime.activate()
    assert str(tmp_path / "own") not in sys.path


def test_a_folder_without_pytorch_is_refused_where_it_is_named_and_where_it_is_used(chosen, tmp_path):
    chosen.pytorch_source, chosen.pytorch_folder = "FOLDER", str(tmp_path)
    assert "has no torch" in drawn(chosen).texts
    with pytest.raises(RuntimeError, match="has no torch; name the folder"):
        bpy.ops.arm.generate(filepath=str(tmp_path))


def test_another_pytorch_than_the_loaded_one_needs_a_restart(chosen, tmp_path):
    import torch  # noqa: F401  # The one of this Python is in use.

    assert not runtime.needs_restart()
    chosen.pytorch_source, chosen.pytorch_folder = "FOLDER", str(torch_in(tmp_path / "own"))
    assert runtime.needs_restart()
    assert "Restart Blender to use the chosen PyTorch" in drawn(chosen).texts


def test_weights_that_do_not_ship_lie_in_the_users_folder(chosen, monkeypatch, tmp_path):
    monkeypatch.setattr(runtime, "_given_weights", None)
    monkeypatch.delenv(weights_folder.VARIABLE, raising=False)
    runtime.activate()
    assert checkpoints.shipped("instantmesh.georm").parent == tmp_path / "weights"
    assert checkpoints.condition("small.georm") == "whole"
    runtime.forget()
    assert weights_folder.VARIABLE not in os.environ
    assert checkpoints.shipped("instantmesh.georm").parent == weights_folder.FOLDER


def test_nothing_is_downloaded_while_blender_is_offline(chosen, lock, monkeypatch):
    monkeypatch.setattr(library_install, "install", lambda *words: pytest.fail("downloaded"))
    assert not bpy.app.online_access
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.arm.install_libraries(extra=runtime.TORCH)
    assert setup_operators.OFFLINE in drawn(chosen).texts


def test_what_the_button_installed_is_used_and_can_be_removed(chosen, online, lock, monkeypatch, tmp_path):
    def install(asked, parent, progress, cache):
        progress(0.5, "Downloading torch")
        assert (asked, parent, cache) == (lock, tmp_path / "libraries", tmp_path / "cache")
        return torch_in(library_install.folder_of(asked, parent))

    monkeypatch.setattr(library_install, "install", install)
    without(monkeypatch, "torch")
    assert bpy.ops.arm.install_libraries(extra=runtime.TORCH) == {"FINISHED"}
    assert chosen.pytorch_source == "INSTALLED"
    runtime.prepare()
    assert Path(sys.path[0]).parent == tmp_path / "libraries"
    assert "arm.remove_libraries" in drawn(chosen).operators
    assert bpy.ops.arm.remove_libraries(extra=runtime.TORCH) == {"FINISHED"}
    assert chosen.pytorch_source == "BUNDLED" and not list((tmp_path / "libraries").iterdir())
    with pytest.raises(RuntimeError, match="Nothing is installed"):
        bpy.ops.arm.remove_libraries(extra=runtime.TORCH)


def test_a_failed_installation_is_said_and_changes_nothing(chosen, online, lock, monkeypatch):
    def failing(*words):
        raise OutputError("/full: cannot be written (No space left on device); free some")

    monkeypatch.setattr(library_install, "install", failing)
    with pytest.raises(RuntimeError, match="No space left on device"):
        bpy.ops.arm.install_libraries(extra=runtime.TORCH)
    assert chosen.pytorch_source == "BUNDLED"
    assert "No space left" in drawn(chosen).texts


def test_without_a_list_for_the_platform_a_folder_is_the_remedy(chosen, online, monkeypatch):
    for module in (runtime, setup_layout, library_install):
        monkeypatch.setattr(module, "lock_of", lambda extra: None)
    assert setup_operators.NO_LIST in drawn(chosen).texts
    with pytest.raises(RuntimeError, match="name a folder that holds the libraries"):
        bpy.ops.arm.install_libraries(extra=runtime.MULTIVIEW)


def test_the_list_shows_all_weights_with_licence_and_condition(chosen):
    assert setup_operators.weights() is None
    assert bpy.ops.arm.list_weights() == {"FINISHED"}
    rows = {row.entry.name: row for row in setup_operators.weights()}
    assert set(rows) == {entry.name for entry in checkpoints.REGISTRY}
    assert rows["small.georm"].condition == "whole" and rows["instantmesh.georm"].condition == "not installed"
    shown = drawn(chosen).texts
    assert "instantmesh.georm: not installed; CC-BY-NC-4.0" in shown
    assert rows["instantmesh.georm"].entry.remedy in shown and str(rows["small.georm"].path) in shown.replace(" ", "")


def test_a_file_that_cannot_be_imported_is_named(chosen, tmp_path):
    with pytest.raises(RuntimeError, match=r"absent\.ckpt: no such file, check the path"):
        bpy.ops.arm.import_weights(filepath=str(tmp_path / "absent.ckpt"), kind="georm")
    assert not (tmp_path / "weights").exists()


def test_weights_are_not_downloaded_while_blender_is_offline(chosen):
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.arm.download_weights(name="matting")


def test_weights_come_at_the_press_of_a_button(chosen, online, monkeypatch):
    asked = []
    monkeypatch.setattr(weights_install, "download", lambda name, progress: asked.append(name))
    bpy.ops.arm.list_weights()
    rows = setup_operators.weights()
    assert drawn(chosen).operators.count("arm.download_weights") == sum(bool(row.entry.download) for row in rows) > 2
    assert bpy.ops.arm.download_weights(name="matting") == {"FINISHED"}
    assert asked == ["matting"]


def test_a_matting_model_comes_with_what_runs_it(chosen, online, monkeypatch, tmp_path):
    done = []

    def install(asked, parent, progress, cache):
        folder = library_install.folder_of(asked, parent)
        (folder / "onnxruntime").mkdir(parents=True)
        done.append(asked.name.partition("-")[0])
        return folder

    def download(name, progress):
        assert any(Path(place).name.startswith("matting-") for place in sys.path), "it is opened to be checked"
        (tmp_path / "weights").mkdir()
        (tmp_path / "weights" / "matting.onnx").touch()
        done.append(name)

    monkeypatch.setattr(matting_operator, "user_folder", lambda kind: tmp_path / kind)
    monkeypatch.setattr(runtime, "_given_weights", None)
    monkeypatch.setattr(library_install, "install", install)
    monkeypatch.setattr(weights_install, "download", download)
    without(monkeypatch, "onnxruntime")
    assert not runtime.has_matting() and "arm.get_matting_model" in drawn(chosen).operators
    assert bpy.ops.arm.get_matting_model() == {"FINISHED"}
    assert done == ["matting", "matting"] and runtime.has_matting()
    assert "The matting model is there" in drawn(chosen).texts
    without(monkeypatch)
    done.clear()
    (tmp_path / "weights" / "matting.onnx").unlink()
    (tmp_path / "weights").rmdir()
    assert bpy.ops.arm.get_matting_model() == {"FINISHED"} and done == ["matting"], "onnxruntime was there already"


def test_no_matting_model_is_downloaded_while_blender_is_offline(chosen):
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.arm.get_matting_model()


def test_work_that_is_going_on_is_shown(chosen, monkeypatch):
    monkeypatch.setattr(background, "progress", lambda: (0.25, "a quarter"))
    assert drawn(chosen).fractions == [(0.25, "a quarter")]
