"""Encoder, cameras, triplane transformer and decoder give InstantMesh's numbers under its weights."""

import math

import pytest
import torch
from torch.nn import functional

from arm_blender.graphics.cameras import front_on_x, look_at, orbit_camera
from arm_blender.models.image_encoder import ImageEncoder, ImageEncoderConfig, camera_embedding
from arm_blender.models.transformer import TransformerConfig, TriplaneTransformer
from arm_blender.models.triplane import DecoderConfig, decoder, sample_planes
from arm_blender.models.vit import resampled_position
from arm_blender.structures import stack_cameras
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.weight_files.key_maps import (
    camera_encoder,
    convert,
    density_decoder,
    distance_decoder,
    triplane_transformer,
)

CAMERAS = "instantmesh_cameras"


@pytest.fixture(scope="module")
def encoder(parity):
    module = ImageEncoder(ImageEncoderConfig(patch_size=8, position_grid=4, width=32, depth=2, heads=2))
    weights = parity("instantmesh_image_encoder").weights
    module.load_state_dict(convert(weights, camera_encoder(2), module.state_dict(), "fixture"))
    return module


@torch.no_grad()
@pytest.mark.parametrize("size", ["native_32x32", "nonsquare_h48_w40", "uneven_h44_w32"])
def test_tokens_under_a_camera_equal_the_published_ones(encoder, parity, size):
    fixture = parity("instantmesh_image_encoder")
    camera = fixture.inputs[f"camera/{size}"][0]
    fixture.check(encoder.camera_embedder(camera), f"camera_embedding/{size}")
    fixture.check(encoder(fixture.inputs[f"image/{size}"][0], camera), f"last_hidden_state/{size}")


@pytest.mark.parametrize(("size", "grid"), [("native_32x32", (4, 4)), ("nonsquare_h48_w40", (6, 5))])
def test_position_embedding_is_interpolated_as_published(encoder, parity, size, grid):
    position = resampled_position(encoder.position, *grid)
    parity("instantmesh_image_encoder").check(position, f"position_embedding/{size}")


@torch.no_grad()
def test_plane_tokens_equal_the_published_ones(parity):
    fixture = parity("instantmesh_triplane_transformer")
    module = TriplaneTransformer(TransformerConfig(width=32, layers=2, heads=4, grid=4), context_width=24)
    weights = {key: tensor for key, tensor in fixture.weights.items() if not key.startswith("deconv.")}
    module.load_state_dict(convert(weights, triplane_transformer(2), module.state_dict(), "fixture"))
    context = fixture.inputs["image_feats"]
    tokens = module.position.expand(2, -1, -1)
    for index, layer in enumerate(module.layers):
        tokens = layer(tokens, context)
        fixture.check(tokens, f"tokens_after_layer_{index}")
    fixture.check(module(context).permute(0, 1, 3, 4, 2).reshape(2, 48, 32), "tokens_after_final_norm")


@torch.no_grad()
def test_density_equals_the_published_one(parity):
    """Raw values are ours with the surface at 0; the density is the same."""
    fixture = parity("instantmesh_triplane_points")
    net = decoder(DecoderConfig(hidden_layers=3, hidden=64), 15, 1)
    net.load_state_dict(convert(fixture.weights, density_decoder(3, "decoder."), net.state_dict(), "fixture"))
    raw = net(sample_planes(fixture.inputs["planes"], fixture.inputs["points"]))
    surface = math.log(math.exp(10.0) - 1.0) + 1.0  # softplus(surface - 1) = 10
    fixture.check(raw + surface, "sigma_raw")
    fixture.check(functional.softplus(raw + surface - 1.0), "sigma_activated")


@torch.no_grad()
def test_a_signed_distance_becomes_positive_inside():
    hidden = {f"net_sdf.{i}.{p}": t for i in (0, 2, 4) for p, t in torch.nn.Linear(64, 64).state_dict().items()}
    last = {"net_sdf.6.weight": torch.randn(1, 64), "net_sdf.6.bias": torch.randn(1)}
    extra = {"net_rgb.0.weight": torch.zeros(1), "net_weight.6.bias": torch.zeros(1)}
    net = decoder(DecoderConfig(hidden_layers=3, hidden=64), 64, 1)
    net.load_state_dict(convert(hidden | last | extra, distance_decoder(3), net.state_dict(), "synthetic"))
    features = torch.randn(20, 64)
    distance = functional.linear(net[:6](features), last["net_sdf.6.weight"], last["net_sdf.6.bias"])
    assert torch.equal(net(features), -distance)


@pytest.mark.parametrize(
    ("name", "distance", "fovy_deg"),
    [("", 4.0, 30.0), ("_radius3.5", 3.5, 30.0), ("_radius2.5_fov50", 2.5, 50.0)],
)
def test_rig_as_the_network_sees_it_is_the_published_one(parity, name, distance, fovy_deg):
    c2w, K = stack_cameras(zero123plus_rig(distance, fovy_deg, size=320))
    parity(CAMERAS).check(camera_embedding(front_on_x(c2w, dim=-2), K, 320)[None], f"input_cameras{name}")


def test_cameras_on_a_sphere_are_the_published_ones(parity):
    fixture = parity(CAMERAS)
    angles = zip(fixture.inputs["azimuth_degrees"].tolist(), fixture.inputs["elevation_degrees"].tolist(), strict=True)
    cameras = tuple(orbit_camera(azimuth, elevation, 2.7, 30.0, 8, 8) for azimuth, elevation in angles)
    fixture.check(front_on_x(stack_cameras(cameras)[0], dim=-2), "c2w_other")
    inverse = torch.stack([camera.w2c for camera in zero123plus_rig()])
    # It takes points of their frame: what stood before x stands before y now.
    fixture.check(front_on_x(inverse, dim=-1), "w2c")


def test_cameras_at_given_places_are_the_published_ones(parity):
    fixture = parity(CAMERAS)
    fixture.check(torch.stack([look_at(eye) for eye in fixture.inputs["positions"]]), "look_at_c2w")
