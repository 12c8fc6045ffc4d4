"""Any mesh of finite vertices goes through decimation, unwrapping and every exporter; cameras are what a file holds."""

import json

import numpy as np
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from arm_blender.errors import ArmError
from arm_blender.export import FORMATS, is_whole, write_asset
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh
from arm_blender.uv.decimate import clean, decimate
from arm_blender.uv.given_mesh import LARGEST, mesh_from_arrays
from arm_blender.uv.mesh_file import read_mesh
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views.transforms_json import read_frames

few = settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
coordinates = st.one_of(
    st.floats(-2.0, 2.0, width=32), st.sampled_from([0.0, 1.0, -1.0, 2.0**-100, LARGEST, -LARGEST, 2.0**-20, 0.5])
)


@st.composite
def meshes(draw) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Vertices, faces, and the UVs of their corners or None."""
    count, faces = draw(st.integers(3, 12)), draw(st.integers(1, 20))
    vertices = draw(arrays.arrays(np.float32, (count, 3), elements=coordinates))
    corners = draw(arrays.arrays(np.int64, (faces, 3), elements=st.integers(0, count - 1)))
    uvs = draw(st.none() | arrays.arrays(np.float32, (3 * faces, 2), elements=st.floats(-3.0, 3.0, width=32)))
    return vertices, corners, uvs


@few
@given(shape=meshes())
def test_any_mesh_is_unwrapped_and_written_or_refused(tmp_path, shape):
    vertices, faces, uvs = shape
    try:
        corners = None if uvs is None else (uvs, np.arange(len(uvs)).reshape(-1, 3))
        mesh = mesh_from_arrays("any", vertices, faces, corners)
        if not isinstance(mesh, UvMesh):
            mesh, _ = unwrap(decimate(clean(mesh), 8), UnwrapConfig(64, time_limit=0.0))
    except ArmError as error:
        assert len(str(error).splitlines()) == 1
        return
    assert bool(mesh.uvs.isfinite().all()) and 0.0 <= float(mesh.uvs.min()) <= float(mesh.uvs.max()) <= 1.0
    maps = MaterialMaps(torch.full((3, 8, 8), 0.5), torch.full((3, 8, 8), 0.5), 0.5, 0.0)
    write_asset(
        RelightableAsset("any", mesh, maps), Report("small", "cpu", 0), tmp_path / "out", formats=tuple(FORMATS)
    )
    assert is_whole(tmp_path / "out")
    back = read_mesh(tmp_path / "out" / "any.glb")
    assert len(back.faces) <= len(mesh.faces)


numbers = st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.integers(-(10**12), 10**12), st.just(10**400))
fields = st.fixed_dictionaries(
    {},
    optional={
        **{name: numbers for name in ("camera_angle_x", "camera_angle_y", "fl_x", "fl_y", "cx", "cy", "k1", "p2")},
        **{name: st.integers(-5, 5000) for name in ("w", "h")},
        "camera_model": st.sampled_from([None, "OPENCV", "PINHOLE", "OPENCV_FISHEYE", 3, "x" * 500]),
        "known": st.lists(st.integers(-3, 40), max_size=5),
        "weight": numbers,
        "ground": numbers,
        "mask_path": st.sampled_from(["m.png", "", None, "../m.png", "\0", 4]),
        "transform_matrix": st.lists(st.lists(numbers, min_size=4, max_size=4), min_size=3, max_size=4),
    },
)


@few
@given(shared=fields, own=st.lists(fields, min_size=1, max_size=3))
def test_any_cameras_are_read_or_refused_in_a_line(tmp_path, shared, own):
    (tmp_path / "0.png").touch()
    pose = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    frames = [{"file_path": "0", "transform_matrix": pose} | one for one in own]
    (tmp_path / "transforms.json").write_text(json.dumps(shared | {"frames": frames}))
    try:
        for frame in read_frames(tmp_path / "transforms.json")[0]:
            camera = frame.camera(32, 24)
            assert bool(camera.K.isfinite().all()) and bool(camera.c2w.isfinite().all())
            frame.known(32, 24)
            assert isinstance(frame.is_bent, bool)
    except ArmError as error:
        assert len(str(error).splitlines()) == 1 and len(str(error)) < 2000
