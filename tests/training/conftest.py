"""Balls as the renderer would leave them, in closed form, and networks of a test's size."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.graphics.color import bytes_from_unit, linear_from_srgb
from arm_blender.models.image_encoder import ImageEncoderConfig
from arm_blender.models.paper.reconstruction import ReconstructionConfig
from arm_blender.models.transformer import TransformerConfig
from arm_blender.models.triplane import DecoderConfig, UpsamplerConfig
from arm_blender.structures import MaterialMaps, RelightableAsset, TriangleMesh
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views.image_io import write_png
from arm_blender.views.transforms_json import write_transforms
from training.evaluation.trials.asset_pictures import map_pictures
from training.evaluation.truth.protocol import Protocol
from training.evaluation.truth.truth import ARRAYS, FRONT, RECORD
from training.rendering.made_up_ball import write_ball
from training.stages import rendered_views

_TINY = ReconstructionConfig(
    encoder=ImageEncoderConfig(image_size=32, patch_size=8, position_grid=4, width=16, depth=1, heads=2),
    transformer=TransformerConfig(width=16, layers=1, heads=2, grid=4),
    upsampler=UpsamplerConfig(filters=8, blocks=1, growth=4, doublings=1, channels=4),
    decoder=DecoderConfig(hidden_layers=2, hidden=16),
)
_SIZE = 48
_BALLS = {"one": (0.6, (0.0, 0.0, 0.0)), "two": (0.4, (0.3, -0.2, 0.1)), "three": (0.5, (-0.2, 0.3, -0.3))}
"""Radius and centre of each object."""


@pytest.fixture(scope="session")
def plane_network() -> ReconstructionConfig:
    """The modules of `paper`."""
    return _TINY


@pytest.fixture
def ball_shards(tmp_path) -> Path:
    """Three balls: "one", "two" and "three"."""
    for name, (radius, center) in _BALLS.items():
        write_ball(tmp_path / "shards" / name, radius, center, _SIZE)
    return tmp_path / "shards"


@pytest.fixture
def shards(ball_shards, monkeypatch) -> Path:
    """Three balls; the last is held out."""
    monkeypatch.setattr(rendered_views, "is_held_out", lambda path: path.parent.name == "three")
    return ball_shards


@pytest.fixture
def one_thread():
    """Networks of this size only wait for each other's threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def ball_asset() -> RelightableAsset:
    """A ball whose colours, roughness and metallic change over it."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.9)
    mesh = TriangleMesh(torch.tensor(np.asarray(ball.vertices), dtype=torch.float32), torch.tensor(ball.faces.copy()))
    unwrapped, _ = unwrap(mesh, UnwrapConfig(256, time_limit=0.0))
    ramp = torch.linspace(0.1, 0.6, 64).expand(1, 64, 64)
    color = torch.cat([ramp, ramp.flip(2), 0.5 * ramp])
    return RelightableAsset("ball", unwrapped, MaterialMaps(color, color, ramp + 0.2, ramp))


@pytest.fixture
def ball_data(ball_asset, tmp_path) -> Path:
    """A data folder with that ball, which glows in its own colour, in split eval; its truth, 4 views of 64², is there.

    That lies in `truth`, as `evaluate` would leave it.
    """
    protocol = Protocol(resolution=64, views=4)
    folder = tmp_path / "truth" / protocol.folder / "ball"
    for place, cameras in ((folder, protocol.inputs()), (folder / FRONT, (protocol.front(),))):
        place.mkdir(parents=True, exist_ok=True)
        shown = map_pictures(ball_asset, cameras)
        names = [f"{k:03d}.png" for k in range(len(cameras))]
        for name, color, alpha in zip(names, shown.albedo, shown.alpha, strict=True):
            write_png(place / name, torch.cat([linear_from_srgb(color), alpha]), srgb=True)
        write_transforms(place / "transforms.json", names, cameras)
    np.savez(folder / "mesh.npz", vertices=ball_asset.mesh.vertices.numpy(), faces=ball_asset.mesh.faces.numpy())
    cameras = (*protocol.tests(), protocol.front())
    shown = map_pictures(ball_asset, cameras)
    images = {"albedo": shown.albedo, "rgba": torch.cat([shown.albedo, shown.alpha], dim=1), "relit": shown.albedo}
    arrays = {name: bytes_from_unit(image).permute(0, 2, 3, 1).numpy() for name, image in images.items()}
    arrays |= {name: bytes_from_unit(getattr(shown, name)[:, 0]).numpy() for name in ("roughness", "metallic")}
    arrays["c2w"], arrays["K"] = (torch.stack([getattr(c, name) for c in cameras]).numpy() for name in ("c2w", "K"))
    np.savez(folder / ARRAYS, **arrays)
    (folder / RECORD).write_text(json.dumps({"input_light": "day.hdr", "other_light": "night.hdr"}))
    entry = {"id": "ball", "set": "pbr", "split": "eval", "main": "ball.glb", "attribution": "us", "licence": "CC0-1.0"}
    (tmp_path / "manifest.json").write_text(json.dumps({"objects": [entry], "hdris": []}))
    return tmp_path
