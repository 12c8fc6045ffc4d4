"""Words for finishes."""

import pytest

from arm_blender.errors import ArmError
from arm_blender.knobs.finishes import PRESETS, Finish, finishes_of, words_of


def test_presets_and_plain_numbers_are_read():
    assert finishes_of(" 2=chrome, 3 = 0.3/1.0,") == {2: PRESETS["chrome"], 3: Finish(0.3, 1.0)}


@pytest.mark.parametrize("words", ["1=gold", "1=matt-paint,2=0.3/1,8=0.25/0", "4=brushed-steel"])
def test_words_come_back_as_they_were(words):
    assert words_of(finishes_of(words)) == words


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("2=chrom", "'chrom': is no finish; give one of matt-paint, .*chrome.*0.3/1"),
        ("2=0.3", "'0.3': is no finish"),
        ("2=0.3/1.5", "from 0 to 1"),
        ("2=nan/0", "is no finish"),
        ("2=0.1/0/1", "is no finish"),
        ("chrome", "chrome: is no finish of a region; give its number, 1 to 8, as in 2=chrome"),
        ("0=chrome", "0=chrome: is no finish of a region"),
        ("9=chrome", "1 to 8"),
        ("²=chrome", "1 to 8"),
        ("2=chrome,2=gold", "region 2 has a finish already"),
        ("", "names no region"),
        (",", "names no region"),
    ],
)
def test_what_is_no_finish_is_refused_in_one_line(words, line):
    with pytest.raises(ArmError, match=line) as refused:
        finishes_of(words)
    assert "\n" not in str(refused.value)


def test_presets_are_in_range():
    for finish in PRESETS.values():
        assert 0.0 <= finish.roughness <= 1.0 and finish.metallic in (0.0, 1.0)
        assert (finish.f0 is not None) == (finish.metallic == 1.0)
        assert finish.f0 is None or all(0.0 <= channel <= 1.0 for channel in finish.f0)


def test_gold_is_yellow_and_chrome_is_grey():
    red, green, blue = PRESETS["gold"].f0
    assert red > green > 2.0 * blue
    assert max(PRESETS["chrome"].f0) - min(PRESETS["chrome"].f0) < 0.02
