"""Installing is all or nothing, stops when it is told to, and takes no file that is not the one of the list."""

import base64
import hashlib
import os
import sys
import zipfile
from pathlib import Path

import pytest

from arm_blender.errors import ArmError, Cancelled
from arm_blender.machine import library_install
from arm_blender.progress import silent


def wheel(folder: Path, name: str) -> str:
    """A wheel with one module in `folder`; returns its SHA-256."""
    info = f"{name}-1.0.dist-info"
    files = {
        f"{name}/__init__.py": f"name = {name!r}\n",
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = ""
    for path, text in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b"=").decode()
        record += f"{path},sha256={digest},{len(text)}\n"
    files[f"{info}/RECORD"] = record + f"{info}/RECORD,,\n"
    target = folder / f"{name}-1.0-py3-none-any.whl"
    with zipfile.ZipFile(target, "w") as archive:
        for path, text in files.items():
            archive.writestr(path, text)
    return hashlib.sha256(target.read_bytes()).hexdigest()


@pytest.fixture
def make_lock(tmp_path):
    """Writes a list whose wheels lie in a folder of this machine."""
    index = tmp_path / "index"
    index.mkdir()

    def make(*names: str, digest: str | None = None) -> Path:
        lines = ["--no-index", f"--find-links {index.as_uri()}"]
        lines += [f"{name}==1.0 --hash=sha256:{digest or wheel(index, name)}" for name in names]
        lock = tmp_path / "extra-linux-x64-cp311.txt"
        lock.write_text("\n".join(lines) + "\n")
        return lock

    return make


@pytest.fixture
def pip(monkeypatch):
    """Puts a script in the place of pip."""

    def put(source: str) -> None:
        monkeypatch.setattr(library_install, "_pip", lambda: [sys.executable, "-c", source])

    return put


def test_all_wheels_of_a_list_are_there_at_the_end(make_lock, tmp_path):
    parent, fractions = tmp_path / "libraries", []
    folder = library_install.install(
        make_lock("arm_one", "arm_two"), parent, lambda fraction, message: fractions.append(fraction)
    )
    assert {path.name for path in folder.iterdir()} >= {"arm_one", "arm_two"}
    assert list(parent.iterdir()) == [folder], "nothing else is left"
    assert fractions == sorted(fractions) and fractions[-1] == 1.0


def test_a_file_with_another_hash_is_refused_and_nothing_is_left(make_lock, tmp_path):
    make_lock("arm_one")
    lock, parent = make_lock("arm_one", digest="0" * 64), tmp_path / "libraries"
    with pytest.raises(ArmError, match="has not the hash that it should have; nothing was installed"):
        library_install.install(lock, parent, silent)
    assert not parent.exists()


def test_what_is_installed_is_not_installed_again_and_an_older_list_goes(make_lock, pip, tmp_path):
    pip("import sys, pathlib; pathlib.Path(sys.argv[sys.argv.index('--target') + 1], 'made').mkdir(parents=True)")
    parent = tmp_path / "libraries"
    older = library_install.install(make_lock("arm_one"), parent, silent)
    lock = make_lock("arm_two")  # Once: a wheel made later holds another time, and has another hash.
    newer = library_install.install(lock, parent, silent)
    assert older != newer and list(parent.iterdir()) == [newer]
    pip("raise SystemExit(1)")
    assert library_install.install(lock, parent, silent) == newer
    library_install.remove(lock, parent)
    assert list(parent.iterdir()) == []


def test_stopping_ends_pip_at_once_and_leaves_nothing(make_lock, pip, tmp_path):
    note = tmp_path / "started"
    pip(
        f"import os, time; open({str(note)!r}, 'w').write(str(os.getpid())); "
        "print('Collecting arm', flush=True); time.sleep(60)"
    )
    parent = tmp_path / "libraries"

    def stop(fraction: float, message: str) -> None:
        if message == "Downloading arm":
            raise Cancelled("stopped by the user")

    with pytest.raises(Cancelled):
        library_install.install(make_lock("arm_one"), parent, stop)
    assert not parent.exists()
    with pytest.raises(ProcessLookupError):
        os.kill(int(note.read_text()), 0)


def test_what_pip_complains_of_reaches_the_user_in_one_line(make_lock, pip, tmp_path):
    pip("print('WARNING: retrying'); print('ERROR: No matching distribution found for arm'); raise SystemExit(1)")
    with pytest.raises(ArmError) as caught:
        library_install.install(make_lock("arm_one"), tmp_path / "libraries", silent)
    assert str(caught.value).startswith("pip: No matching distribution found for arm; see the console, or name")


def test_without_pip_the_one_that_python_carries_along_is_taken(monkeypatch):
    find = library_install.importlib.util.find_spec
    monkeypatch.setattr(library_install.importlib.util, "find_spec", lambda name: None if name == "pip" else find(name))
    command = library_install._pip()
    assert Path(command[-1]).name == "pip" and Path(command[-1]).parent.is_file()
    monkeypatch.setattr(library_install.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ArmError, match="has no pip; install the libraries elsewhere, and name their folder"):
        library_install._pip()
