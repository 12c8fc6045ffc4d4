"""What is missing is named, and libraries in a folder are found where they should be, and only there."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from arm_blender.errors import ArmError
from arm_blender.machine import libraries, library_install

ROOT = Path(__file__).parents[2]
LOCKS = sorted(library_install.LOCKS.glob("*.txt"))


def package(folder: Path, name: str, source: str = "") -> Path:
    (folder / name).mkdir(parents=True)
    (folder / name / "__init__.py").write_text(source)
    return folder


def python(source: str, folder: Path) -> str:
    """What a fresh Python prints; `folder` is its last word."""
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{source}", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_what_is_missing_is_named_and_nothing_is_imported(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(package(tmp_path, "arm_present", "raise RuntimeError('imported')")))
    asked = {"there": "arm_present", "gone": "arm_absent", "standard": "json"}
    assert libraries.missing(asked) == ["gone"]
    assert "arm_present" not in sys.modules


def test_a_module_that_is_blocked_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "arm_blocked", None)
    assert libraries.missing({"blocked": "arm_blocked"}) == ["blocked"]


@pytest.mark.parametrize("first, found", [(True, "folder"), (False, "own")])
def test_a_folder_comes_before_or_after_what_python_has(tmp_path, first, found):
    package(tmp_path / "own", "arm_torch", "place = 'own'")
    package(tmp_path / "folder", "arm_torch", "place = 'folder'")
    source = f"""
from pathlib import Path
from arm_blender.machine import libraries
sys.path.insert(0, sys.argv[1] + "/own")
libraries.add_folder(Path(sys.argv[1], "folder"), ["arm_torch"], first={first})
libraries.add_folder(Path(sys.argv[1], "folder"), ["arm_torch"], first={first})
import arm_torch
libraries.remove_folder(Path(sys.argv[1], "folder"))
print(arm_torch.place, sys.argv[1] + "/folder" in sys.path)
"""
    assert python(source, tmp_path) == f"{found} False"


def test_a_numpy_in_the_folder_never_takes_the_place_of_blenders(tmp_path):
    package(package(tmp_path, "arm_torch"), "numpy", "raise RuntimeError('the wrong numpy')")
    source = """
from pathlib import Path
from arm_blender.machine import libraries
libraries.add_folder(Path(sys.argv[1]), ["arm_torch"], first=True)
import arm_torch, numpy, numpy.fft
print(numpy.fft.fft([1.0, 1.0])[0].real)
"""
    assert python(source, tmp_path) == "2.0"


def test_a_folder_without_the_library_is_refused(tmp_path):
    with pytest.raises(ArmError, match=r"has no torch; name the folder that `pip install --target` filled"):
        libraries.add_folder(tmp_path, ["torch"])
    assert str(tmp_path) not in sys.path


@pytest.mark.parametrize("name", ["_C.cpython-37m-x86_64-linux-gnu.so", "_C.cp37-win_amd64.pyd"])
def test_a_library_for_another_python_is_refused(tmp_path, name):
    (package(tmp_path, "torch") / "torch" / name).touch()
    with pytest.raises(ArmError, match=f"{re.escape(name)} is for another Python; install it with Python 3"):
        libraries.check_folder(tmp_path, ["torch"])


@pytest.mark.parametrize("name", ["lib.abi3.so", f"_C.cpython-{sys.version_info[0]}{sys.version_info[1]}-darwin.so"])
def test_a_library_for_this_python_is_taken(tmp_path, name):
    (package(tmp_path, "torch") / "torch" / name).touch()
    libraries.check_folder(tmp_path, ["torch"])


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.stem)
def test_a_list_pins_every_wheel_by_its_hash_and_never_numpy(lock):
    lines = [line for line in lock.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    names = [re.fullmatch(r"([a-z0-9.-]+)==[\w.]+ --hash=sha256:[0-9a-f]{64}", line)[1] for line in lines]
    assert not {"numpy", "torchvision", "torchaudio"} & set(names)
    extra = lock.stem.partition("-")[0]
    wanted, fewest = {
        "torch": ({"torch"}, 20),
        "photos": (set(libraries.PHOTOS), 3),
        "matting": ({"onnxruntime"}, 3),
        "multiview": ({"diffusers", "transformers", "tokenizers", "onnxruntime"}, 20),
    }[extra]
    assert wanted <= set(names) and len(names) >= fewest and ("torch" in names) == lock.stem.startswith("torch")


def test_the_lists_and_the_zip_have_the_versions_that_the_tests_run_with():
    pins = dict(
        line.lower().split("==")
        for name in ("requirements.txt", "requirements-dev.txt")
        for line in (ROOT / name).read_text(encoding="utf-8").splitlines()
        if "==" in line and not line.startswith("#")
    )
    wheels = tomllib.loads((ROOT / "tools" / "extension_wheels.toml").read_text(encoding="utf-8"))
    bundled = {name.lower(): version for name, version in (wheels["libraries"] | wheels["torch"]).items()}
    assert bundled == {name: pins[name] for name in bundled}
    assert set(bundled) | {"numpy"} == {name.lower() for name in libraries.REQUIRED}
    for lock in LOCKS:
        for name in ("torch", "diffusers", "transformers", "onnxruntime"):
            pinned = re.search(rf"^{name}==(\S+) ", lock.read_text(encoding="utf-8"), re.MULTILINE)
            assert pinned is None or pinned[1] == pins[name], f"{lock.name}: {name}"
