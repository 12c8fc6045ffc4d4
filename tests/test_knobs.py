"""Each knob is declared once, and is everywhere that a user may turn it."""

import argparse
from dataclasses import dataclass, fields
from typing import get_args

import pytest

from arm_blender import config, knobs
from arm_blender.__main__ import parser
from arm_blender.commands import batch, generate
from arm_blender.config import Settings
from arm_blender.errors import ArmError
from arm_blender.knobs import DrawingKnobs, Knobs, ViewKnobs, knobs_of, values_of
from arm_blender.knobs.declaring import Shown, knob, within
from arm_blender.views import ViewOptions
from arm_blender.views.zero123plus.sampling import BACKGROUNDS, Zero123PlusConfig

ALL = [(declared, one) for declared in (Knobs, ViewKnobs, DrawingKnobs) for one in knobs_of(declared)]
CONFIGS = {Knobs: Settings, ViewKnobs: ViewOptions, DrawingKnobs: Zero123PlusConfig}


def test_every_field_of_a_class_of_knobs_is_a_knob():
    for declared in CONFIGS:
        assert [one.name for one in knobs_of(declared)] == [entry.name for entry in fields(declared)]


def test_options_and_fields_have_names_of_their_own():
    """All lie in one namespace: that of the command line."""
    for names in ([one.name for _, one in ALL], [one.option for _, one in ALL]):
        assert len(set(names)) == len(names)


@pytest.mark.parametrize("command", [["generate", "VIEWS"], ["batch", "LIST"]], ids=" ".join)
def test_every_knob_is_an_option_that_begins_at_its_default(command):
    args = parser().parse_args([*command, "--output", "OUT"])
    for declared, one in ALL:
        assert getattr(args, one.name) == one.default == vars(declared())[one.name]
    assert set(batch._COLUMNS) == {one.column for _, one in ALL if one.listed} | {"mesh", "mesh_up", "place"}


def test_every_config_has_its_knobs_as_they_are_declared():
    for declared, config_type in CONFIGS.items():
        assert issubclass(config_type, declared)
        assert {one.name: one.default for one in knobs_of(config_type)} == vars(declared())


def test_names_are_those_of_what_they_choose():
    assert get_args(knobs.PresetName) == tuple(config.PRESETS)
    assert get_args(knobs.QualityName) == tuple(config.QUALITIES)
    assert get_args(knobs.BackgroundName) == tuple(BACKGROUNDS)


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({"preset": "huge"}, "--preset huge: unknown; choose one of small, paper, instantmesh"),
        ({"texture_size": 300}, "--texture-size 300: give a power of two from 256 to 8192"),
        ({"faces": 99}, "--faces 99: give at least 100"),
        ({"grid": 513}, "--grid 513: give 16 to 512"),
        ({"threads": 1025}, "--threads 1025: give 1 to 1024"),
        ({"time_limit": 4.5}, "--time-limit 4.5: give 5 seconds or more"),
        ({"time_limit": float("nan")}, "--time-limit nan: give 5 seconds or more"),
        ({"seed": -1}, r"--seed -1: give 0 to 2\*\*63 - 1"),
    ],
)
def test_a_value_out_of_range_is_one_line_with_the_remedy(wrong, line):
    with pytest.raises(ArmError, match=f"^{line}$"):
        Settings(**wrong)


def test_a_new_knob_is_declared_and_read_and_nothing_else(monkeypatch):
    """Options, columns and checks follow from the declaration; so do the panel's properties, which its tests hold."""

    @dataclass(frozen=True, kw_only=True)
    class More(Knobs):
        shine: float | None = knob(
            None, "how much it shines", within(0.0, 1.0), letter="S", listed=True, shown=Shown("Shine", "How much")
        )

    monkeypatch.setattr(generate, "Knobs", More)
    command = argparse.ArgumentParser()
    generate.add_options(command)
    args = command.parse_args(["--output", "OUT", "--shine", "1.5"])
    chosen = More(**values_of(More, args))
    assert chosen.shine == 1.5 and "--shine S" in command.format_help()
    with pytest.raises(ArmError, match="--shine 1.5: give 0 to 1"):
        knobs.check(chosen)
