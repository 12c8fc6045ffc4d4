"""What the training renderer makes of the reflection that a file speaks of."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.color import linear_from_srgb
from training.rendering.assets import Asset

pytest.importorskip("bpy")
from training.rendering.lighting_blender import set_world  # noqa: E402  They need bpy.
from training.rendering.passes_blender import RenderConfig, configure_cycles  # noqa: E402
from training.rendering.render_blender import SampleConfig, prepare_object, render_views  # noqa: E402

pytestmark = pytest.mark.blender

FACES = "f 1 3 7 5\nf 2 6 8 4\nf 1 5 6 2\nf 3 4 8 7\nf 1 2 4 3\nf 5 7 8 6\n"


def black_mirror(folder: Path, reflection: str) -> Path:
    """A smooth black cube, whose .mtl says `reflection`."""
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    (folder / "cube.mtl").write_text(f"newmtl black\nKd 0 0 0\nNs 1000\n{reflection}\n")
    (folder / "cube.obj").write_text(f"mtllib cube.mtl\n{corners}usemtl black\n{FACES}")
    return folder / "cube.obj"


@pytest.mark.parametrize("reflection", ["Ks 0 0 0", "Ks 1 1 1", "Ks 0.5 0.5 0.5\nNi 2.2"])
def test_every_dielectric_reflects_four_percent(reflection, tmp_path):
    """Seen head-on under a white sky, a black face is as bright as what it reflects: ((1.5 - 1) / (1.5 + 1))^2."""
    sky = oiio.ImageBuf(oiio.ImageSpec(8, 4, 3, oiio.FLOAT))
    sky.set_pixels(sky.roi, np.ones((4, 8, 3), np.float32))
    sky.write(str(tmp_path / "sky.exr"))
    asset = Asset("cube", str(black_mirror(tmp_path, reflection)), "cube.obj", own_finish=True)
    prepare_object(asset, np.random.default_rng(0), SampleConfig(), check=False)
    set_world(tmp_path / "sky.exr", 0.0, 1.0)
    configure_cycles(RenderConfig(resolution=9, samples=4, denoise=False, gpu=False))
    (view,) = render_views((orbit_camera(0.0, 0.0, 6.0, 10.0, 9, 9),))
    assert view["rgba"][4, 4, 3] == 255 and view["roughness"][4, 4] == 0
    seen = linear_from_srgb(torch.from_numpy(view["rgba"][4, 4, :3]) / 255.0)
    assert seen.tolist() == pytest.approx([0.04] * 3, abs=0.001)  # A step of 8 bits is 0.0013 there.
