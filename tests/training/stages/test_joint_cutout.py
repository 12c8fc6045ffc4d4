"""The stage of the joint look: a short fit on captures learns what is the object, and its weights fit the product."""

import pytest

from arm_blender.models.small.cutout import Cutout, CutoutConfig
from arm_blender.photographs.masks.joint_look import CONFIG
from arm_blender.weight_files import checkpoints
from training.__main__ import main
from training.stages.cutout import validate
from training.stages.joint_cutout import plain, read_capture

from ..datasets.test_joint_samples import capture  # noqa: F401 (a fixture)

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.slow
def test_a_short_fit_learns_what_all_pictures_say(capture, tmp_path):  # noqa: F811
    output = tmp_path / "joint.safetensors"
    words = ["--steps", "40", "--batch", "4", "--size", "64", "--learning-rate", "5e-3", "--average", "0.8"]
    assert main(["fit", "joint-cutout", "--captures", str(capture.parent), "--output", str(output), *words]) == 0
    config, state = checkpoints.load(output, CutoutConfig)
    assert config == CONFIG
    network = Cutout(config).eval()
    checkpoints.restore(network, state, output)
    assert validate(network, plain([read_capture(capture, 64, 0)]))["IoU"] > 0.7


def test_without_captures_it_says_so(tmp_path, capsys):
    words = ["--captures", str(tmp_path), "--output", str(tmp_path / "joint.safetensors")]
    assert main(["fit", "joint-cutout", *words]) == 1
    assert "render more" in capsys.readouterr().err
