"""One folder holds one asset."""

import pytest

from arm_blender.errors import OutputError
from arm_blender.export.one_asset import check_asset_folder, source_of
from arm_blender.report import FILE_NAME, Report


def finished(folder, name: str, views):
    folder.mkdir(parents=True, exist_ok=True)
    report = Report("small", "cpu", 0, name=name, views=source_of(views, folder))
    report.write(folder / FILE_NAME)
    (folder / f"{name}.blend").touch()
    return folder


def test_an_empty_folder_and_the_same_asset_will_do(tmp_path):
    views = tmp_path / "cup"
    check_asset_folder(tmp_path / "none", "cup", views)
    out = finished(tmp_path / "out", "cup", views)
    check_asset_folder(out, "cup", views)
    out.rename(tmp_path / "moved")
    with pytest.raises(OutputError, match="made of"):
        check_asset_folder(tmp_path / "moved", "cup", tmp_path / "other" / "cup")
    check_asset_folder(tmp_path / "moved", "cup", views)


@pytest.mark.parametrize(("name", "views"), [("mug", "mug"), ("cup", "shelf/cup"), ("cup", "mug")])
def test_another_asset_is_refused_with_what_to_do(tmp_path, name, views):
    out = finished(tmp_path / "out", "cup", tmp_path / "cup")
    with pytest.raises(OutputError, match=r"holds the asset cup.*--output"):
        check_asset_folder(out, name, tmp_path / views)


def test_other_views_are_refused_before_the_name_is_known(tmp_path):
    out = finished(tmp_path / "out", "cup", tmp_path / "cup")
    check_asset_folder(out, None, tmp_path / "cup")
    with pytest.raises(OutputError, match="holds the asset cup, made of"):
        check_asset_folder(out, None, tmp_path / "mug")
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "house.blend").touch()
    check_asset_folder(tmp_path / "own", None, tmp_path / "mug")


def test_views_that_a_run_left_in_its_own_folder_are_of_its_asset(tmp_path):
    out = finished(tmp_path / "out", "cup", tmp_path / "cup.png")
    check_asset_folder(out, "views", out / "views")


def test_a_blend_that_no_run_has_written_stays(tmp_path):
    for name in ("cup", "house"):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.blend").write_text("work of weeks")
        with pytest.raises(OutputError, match=f"holds {name}.blend"):
            check_asset_folder(tmp_path / name, "cup", tmp_path / "cup.png")
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "0.png").touch()
    check_asset_folder(tmp_path / "pictures", "cup", tmp_path / "pictures" / "0.png")


def test_a_run_that_was_killed_while_it_put_files_there_can_be_made_again(tmp_path):
    out = finished(tmp_path / "out", "cup", tmp_path / "cup.png")
    (out / ".unfinished-x").mkdir()
    (out / FILE_NAME).rename(out / ".unfinished-x" / FILE_NAME)
    check_asset_folder(out, "cup", tmp_path / "cup.png")
    with pytest.raises(OutputError, match="holds the asset cup"):
        check_asset_folder(out, "mug", tmp_path / "mug.png")


def test_a_report_of_an_earlier_version_goes_by_the_blend(tmp_path):
    out = finished(tmp_path / "out", "cup", tmp_path / "cup.png")
    (out / FILE_NAME).write_text('{"version": "0.1"}')
    check_asset_folder(out, "cup", tmp_path / "cup.png")
    with pytest.raises(OutputError, match=r"holds cup\.blend"):
        check_asset_folder(out, "mug", tmp_path / "mug.png")
