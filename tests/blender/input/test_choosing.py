"""What is chosen in the file browser becomes one path: a file, a folder, or a new folder of some pictures."""

import numpy as np
import pytest
from PIL import Image

import arm_blender
from arm_blender.errors import ArmError

bpy = pytest.importorskip("bpy")
from arm_blender.blender.input.chosen_pictures import chosen_path  # noqa: E402

pytestmark = pytest.mark.blender

NAMES = [f"IMG_{index}.jpg" for index in range(4)]


@pytest.fixture
def shoe(tmp_path):
    """A folder of four photographs, a video and a note."""
    folder = tmp_path / "shoe"
    folder.mkdir()
    for index, name in enumerate(NAMES):
        Image.fromarray(np.full((30, 40, 3), 40 * index, np.uint8)).save(folder / name)
    (folder / "walk.mov").write_bytes(b"no video")
    (folder / "note.txt").write_text("mine")
    return folder


@pytest.fixture
def panel(empty_file):
    arm_blender.register()
    yield bpy.context.scene.arm
    arm_blender.unregister()


def test_one_file_a_video_and_the_whole_folder_are_taken_as_they_are(shoe, tmp_path):
    assert chosen_path(shoe, ["IMG_2.jpg"]) == shoe / "IMG_2.jpg"
    assert chosen_path(shoe, ["walk.mov"]) == shoe / "walk.mov"
    assert chosen_path(shoe, []) == chosen_path(shoe, [""]) == chosen_path(shoe, NAMES[::-1]) == shoe
    assert list(tmp_path.iterdir()) == [shoe]


def test_some_pictures_are_a_folder_beside_which_is_found_again(shoe):
    place = chosen_path(shoe, NAMES[:3])
    assert place == shoe.parent / "shoe-chosen" and sorted(path.name for path in place.iterdir()) == NAMES[:3]
    assert (place / NAMES[1]).read_bytes() == (shoe / NAMES[1]).read_bytes()
    (place / "masks").mkdir()
    assert chosen_path(shoe, NAMES[2::-1]) == place
    other = chosen_path(shoe, NAMES[1:])
    assert other == shoe.parent / "shoe-chosen-2" and sorted(path.name for path in place.glob("*.jpg")) == NAMES[:3]


def test_without_links_they_are_copied(shoe, monkeypatch):
    def refused(*_):
        raise OSError("no links here")

    monkeypatch.setattr("os.link", refused)
    place = chosen_path(shoe, NAMES[:2])
    assert chosen_path(shoe, NAMES[:2]) == place and (place / NAMES[0]).stat().st_nlink == 1


@pytest.mark.parametrize(("other", "line"), [("walk.mov", "walk.mov: is a video"), ("note.txt", "note.txt: is no")])
def test_what_does_not_go_together_is_named(shoe, other, line):
    with pytest.raises(ArmError, match=line):
        chosen_path(shoe, [NAMES[0], other])


def test_the_button_sets_the_views_and_lists_them(panel, shoe):
    files = [{"name": name} for name in NAMES[:3]]
    panel.source = "CAMERAS"
    assert bpy.ops.arm.choose_photographs(directory=str(shoe), files=files) == {"FINISHED"}
    assert (panel.source, panel.views_path) == ("FILES", str(shoe.parent / "shoe-chosen"))
    bpy.ops.arm.look()
    assert [view.name for view in panel.views] == NAMES[:3]
    assert bpy.ops.arm.choose_photographs(directory=str(shoe)) == {"FINISHED"} and panel.views_path == str(shoe)
    with pytest.raises(RuntimeError, match=r"walk\.mov: is a video"):
        bpy.ops.arm.choose_photographs(directory=str(shoe), files=[*files, {"name": "walk.mov"}])
    with pytest.raises(RuntimeError, match="Choose files"):
        bpy.ops.arm.choose_photographs(directory=str(shoe / "gone"))
