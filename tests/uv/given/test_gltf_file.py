"""What a glTF claims is held against what it holds, before memory is taken."""

import copy
import json
import struct

import numpy as np
import pytest
import torch

from arm_blender.errors import EmptyMeshError
from arm_blender.structures import UvMesh
from arm_blender.uv.mesh_file import read_mesh

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
UVS = np.array([[0, 65535], [65535, 65535], [0, 0]], np.uint16)
GOOD = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 2}, "indices": 1}]}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        {"bufferView": 2, "componentType": 5123, "count": 3, "type": "VEC2", "normalized": True},
    ],
    "bufferViews": [
        {"buffer": 0, "byteLength": 36},
        {"buffer": 0, "byteOffset": 36, "byteLength": 12},
        {"buffer": 0, "byteOffset": 48, "byteLength": 12},
    ],
    "buffers": [{"byteLength": 60}],
}


def packed(gltf: dict, indices=(0, 1, 2)) -> bytes:
    blob = POINTS.tobytes() + np.array(indices, np.uint32).tobytes() + UVS.tobytes()
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def test_integers_that_stand_for_shares_are_uvs(tmp_path):
    (tmp_path / "good.glb").write_bytes(packed(GOOD))
    mesh = read_mesh(tmp_path / "good.glb")
    assert isinstance(mesh, UvMesh)
    # The file's (x, y, 0) is our (x, 0, y); v is up with us, and down in a glTF.
    torch.testing.assert_close(mesh.uvs[mesh.face_uvs], mesh.vertices[mesh.faces][..., [0, 2]])


def test_a_gltf_with_its_buffer_beside_it_is_read_and_none_from_elsewhere(tmp_path):
    blob = packed(GOOD)[-60:]
    (tmp_path / "in").mkdir()
    for folder in (tmp_path, tmp_path / "in"):
        (folder / "data one.bin").write_bytes(blob)
    for uri, fits in (("data%20one.bin", True), ("../data%20one.bin", False)):
        gltf = GOOD | {"buffers": [{"byteLength": 60, "uri": uri}]}
        (tmp_path / "in" / "good.gltf").write_text(json.dumps(gltf))
        if fits:
            assert isinstance(read_mesh(tmp_path / "in" / "good.gltf"), UvMesh)
        else:
            with pytest.raises(EmptyMeshError, match="outside of the folder"):
                read_mesh(tmp_path / "in" / "good.gltf")


def change(path: tuple, value):
    def apply(gltf):
        place = gltf
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value

    return apply


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (change(("accessors", 0, "count"), 300_000_000), "claims 300000000 values, more than the file holds"),
        (change(("accessors", 0), {"componentType": 5126, "count": 300_000_000, "type": "VEC3"}), "no plain data"),
        (change(("accessors", 0, "count"), -1), "stands where a number has to be"),
        (change(("accessors", 0, "type"), "VEC2"), "not VEC3"),
        (change(("accessors", 0, "byteOffset"), 10**400), "claims"),
        (change(("bufferViews", 0, "byteStride"), 1), "claims"),
        (change(("nodes",), [{"children": [1]}, {"mesh": 0, "children": [0]}]), "below itself"),
        (
            change(("nodes",), [{"children": [1] * 50}, {"children": [2] * 50}, {"children": [3] * 50}, {"mesh": 0}]),
            "over",
        ),
        (change(("buffers", 0, "byteLength"), 10**9), "claims 1000000000 bytes"),
        (change(("extensionsUsed",), ["KHR_draco_mesh_compression"]), "Draco; export it without compression"),
        (change(("meshes",), 7), "cannot be read"),
    ],
)
def test_what_a_file_cannot_hold_is_refused_by_name(tmp_path, wrong, says):
    gltf = copy.deepcopy(GOOD)
    wrong(gltf)
    (tmp_path / "bad.glb").write_bytes(packed(gltf))
    with pytest.raises(EmptyMeshError, match=says) as error:
        read_mesh(tmp_path / "bad.glb")
    assert "bad.glb" in str(error.value)


def test_a_face_beyond_the_vertices_is_refused(tmp_path):
    (tmp_path / "bad.glb").write_bytes(packed(GOOD, (0, 1, 99)))
    with pytest.raises(EmptyMeshError, match="a face has vertex 99 of 3"):
        read_mesh(tmp_path / "bad.glb")


def test_pictures_in_a_file_are_not_opened(tmp_path):
    broken = {"images": [{"uri": "data:image/png;base64,AAAA"}], "textures": [{"source": 0}]}
    broken |= {"materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}
    gltf = copy.deepcopy(GOOD) | broken
    gltf["meshes"][0]["primitives"][0]["material"] = 0
    (tmp_path / "good.glb").write_bytes(packed(gltf))
    assert isinstance(read_mesh(tmp_path / "good.glb"), UvMesh)
