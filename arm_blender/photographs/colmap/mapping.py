"""Cameras from pictures, by COLMAP: features and matches, cameras and points, and a second opinion.

Loaded by `process.py` alone, which says what may be imported. Models are written into the job's folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats: TypeAlias = NDArray[np.float64]

Tell: TypeAlias = Callable[..., None]
"""Tells the parent something: `fraction` and `message`, or words of another kind."""

MOST_FEATURES = 4096
"""Of a picture. More take longer to match, by the square, and bring weak ones."""

SMALLEST_ANGLE_DEG = 8.0
"""Between the two pictures that a solution begins with."""

MOST_FOCAL_CHANGE = {True: 0.15, False: 0.5}
"""Share by which a focal length may move when it is set free: one that the camera stated, and one that was tried."""

MOST_RADIAL = 0.3
"""Of the radial parameter: more is no phone's lens, but a solution that bends."""

EPIPOLAR_PIXELS = 4.0
"""How far a match may lie from where the solved cameras allow it."""


def match(job: dict[str, Any], tell: Tell) -> None:
    """Features of all pictures, and which of them are the same in any two, into the database of the job."""
    import pycolmap

    pycolmap.set_random_seed(job["seed"])
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu, extraction.num_threads = False, job["threads"]
    extraction.sift.max_num_features = MOST_FEATURES
    extraction.sift.estimate_affine_shape = extraction.sift.domain_size_pooling = True
    done, count = 0, sum(len(lens["pictures"]) for lens in job["lenses"])
    for lens in job["lenses"]:
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = "SIMPLE_RADIAL"
        if job["masks"]:
            reader.mask_path = job["masks"]
        if lens["focal"]:
            reader.camera_params = f"{lens['focal']},{lens['width'] / 2},{lens['height'] / 2},0"
        for start in range(0, len(lens["pictures"]), job["threads"]):
            names = lens["pictures"][start : start + job["threads"]]
            tell(fraction=0.4 * done / count, message=f"finding features: picture {done + 1} of {count}")
            pycolmap.extract_features(
                job["database"],
                job["pictures"],
                names,
                camera_mode=pycolmap.CameraMode.SINGLE,
                reader_options=reader,
                extraction_options=extraction,
                device=pycolmap.Device.cpu,
            )
            if start == 0:
                with pycolmap.Database.open(job["database"]) as database:
                    reader.existing_camera_id = _camera_of(database, names[0])
            done += len(names)
    tell(fraction=0.4, message="matching features")
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu, matching.num_threads, matching.guided_matching = False, job["threads"], True
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = job["seed"]
    pycolmap.match_exhaustive(
        job["database"],
        matching_options=matching,
        verification_options=verification,
        device=pycolmap.Device.cpu,
    )


def _camera_of(database: Any, name: str) -> int:
    """The number of a picture's camera."""
    image = database.read_image_with_name(name)
    if image is None:
        raise ValueError(f"picture {name} was not read")
    return int(image.camera_id)


def map_pictures(job: dict[str, Any], tell: Tell) -> None:
    """Cameras and points from the matches of a database, for the focal length of the job where it has one."""
    import pycolmap

    pycolmap.set_random_seed(job["seed"])
    if job["factor"]:
        with pycolmap.Database.open(job["database"]) as database:
            for camera in database.read_all_cameras():
                if not camera.has_prior_focal_length:
                    camera.params = [job["factor"] * max(camera.width, camera.height), *camera.params[1:]]
                    database.update_camera(camera)
    registered = 0

    def next_picture() -> None:
        nonlocal registered
        registered += 1
        tell(fraction=0.5, message=f"solving cameras: {registered + 2} of {job['count']}")

    folder = Path(job["models"])
    folder.mkdir(parents=True, exist_ok=True)
    found = pycolmap.incremental_mapping(
        job["database"], job["pictures"], folder, _mapping_options(job), next_image_callback=next_picture
    )
    models = sorted(found.values(), key=lambda model: -model.num_reg_images())
    tell(models=[sorted(model.images[index].name for index in model.reg_image_ids()) for model in models])
    if models:
        tell(fraction=0.8, message="refining the cameras")
        _write(models[0], job, "fixed")
        if job["refine"]:
            _write(_refined(models[0], job), job, "refined")


def map_again(job: dict[str, Any], tell: Tell) -> None:
    """A second opinion from the same matches, all cameras at once, with the focal lengths of the first solution."""
    import pycolmap

    with pycolmap.Database.open(job["database"]) as database:
        for lens in job["solved"]:
            camera = database.read_camera(_camera_of(database, lens["picture"]))
            camera.params, camera.has_prior_focal_length = lens["parameters"], True
            database.update_camera(camera)
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads, options.random_seed, options.min_num_matches = job["threads"], job["seed"], 10
    options.mapper.global_positioning.use_gpu = options.mapper.bundle_adjustment.ceres.use_gpu = False
    adjustment = options.mapper.bundle_adjustment
    adjustment.refine_focal_length = adjustment.refine_extra_params = False
    adjustment.ceres.solver_options.num_threads = job["threads"]
    tell(fraction=0.9, message="comparing with a second solution")
    folder = Path(job["models"])
    folder.mkdir(parents=True, exist_ok=True)
    found = pycolmap.global_mapping(job["database"], job["pictures"], folder, options)
    if found:
        _write(max(found.values(), key=lambda model: model.num_reg_images()), job, "again")


def _mapping_options(job: dict[str, Any]) -> Any:
    """What was found to work where a thing stands on a table; focal length and lens are held."""
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = job["threads"], job["seed"]
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    options.ba_use_gpu = options.extract_colors = False
    options.min_num_matches, options.min_model_size = 10, 3
    options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = False
    options.mapper.init_min_num_inliers = 50
    options.mapper.abs_pose_min_num_inliers = 15
    options.mapper.init_min_tri_angle = SMALLEST_ANGLE_DEG
    return options


def _refined(model: Any, job: dict[str, Any]) -> Any:
    """A copy of `model` with free focal lengths and radial parameters; points are found again between the rounds."""
    import pycolmap

    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = True
    options.ceres.use_gpu, options.ceres.solver_options.num_threads = False, job["threads"]
    folder = Path(job["models"], "refined")
    folder.mkdir(exist_ok=True)
    model.write(folder)
    refined = pycolmap.Reconstruction(folder)
    pycolmap.bundle_adjustment(refined, options)
    if not _plausible(model, refined):
        return refined
    refined = pycolmap.triangulate_points(refined, job["database"], job["pictures"], folder, clear_points=True)
    pycolmap.bundle_adjustment(refined, options)
    return refined


def _plausible(held: Any, refined: Any) -> bool:
    """Whether the free lenses of `refined` are still what the cameras said, or what may be sold."""
    for index, camera in refined.cameras.items():
        before = held.cameras[index]
        change = abs(camera.params[0] / before.params[0] - 1.0)
        if not (change <= MOST_FOCAL_CHANGE[before.has_prior_focal_length] and abs(camera.params[3]) <= MOST_RADIAL):
            return False
    return True


def _write(model: Any, job: dict[str, Any], name: str) -> None:
    """A model as NAME.json and NAME.npz: cameras and points, and what says how far they are to be trusted."""
    import numpy as np

    ids = sorted(model.reg_image_ids())
    images = [model.images[index] for index in ids]
    place = {index: row for row, index in enumerate(ids)}
    points, errors, seen = [], [], []
    for row, point in enumerate(model.points3D.values()):
        points.append(point.xyz)
        errors.append(point.error)
        for element in point.track.elements:
            observed = model.images[element.image_id].points2D[element.point2D_idx].xy
            seen.append((place[element.image_id], row, *observed))
    folder = Path(job["models"])
    np.savez(
        folder / f"{name}.npz",
        points=np.array(points, np.float64).reshape(-1, 3),
        errors=np.array(errors, np.float64),
        seen=np.array(seen, np.float64).reshape(-1, 4),
        pairs=_pairs(model, job["database"], place),
    )
    pictures = []
    for image in images:
        camera = model.cameras[image.camera_id]
        pictures.append(
            {
                "name": image.name,
                "world_to_camera": image.cam_from_world().matrix().tolist(),
                "model": camera.model.name,
                "parameters": [float(value) for value in camera.params],
                "width": camera.width,
                "height": camera.height,
            }
        )
    text = json.dumps({"pictures": pictures, "error": float(model.compute_mean_reprojection_error())})
    (folder / f"{name}.json").write_text(text, encoding="utf-8")


def _pairs(model: Any, path: str, place: dict[int, int]) -> Floats:
    """(Q, 4) of every two pictures with matches: their places, how many, how many the solved cameras allow.

    The matches were found without any solution: those that it must throw away speak against it.
    """
    import numpy as np
    import pycolmap

    rows = []
    with pycolmap.Database.open(path) as database:
        numbers, geometries = database.read_two_view_geometries()
        rays = {index: _rays(model, index, database.read_keypoints(index)) for index in place}
    for number, geometry in zip(numbers, geometries, strict=True):
        first, second = pycolmap.pair_id_to_image_pair(number)
        matches = np.asarray(geometry.inlier_matches)
        if first not in place or second not in place or not len(matches):
            continue
        motion = model.images[second].cam_from_world() * model.images[first].cam_from_world().inverse()
        essential = pycolmap.essential_matrix_from_pose(motion)
        a, b = rays[first][matches[:, 0]], rays[second][matches[:, 1]]
        line_b, line_a = a @ essential.T, b @ essential
        off = np.abs((b * line_b).sum(axis=1))
        off /= np.sqrt((line_a[:, :2] ** 2).sum(axis=1) + (line_b[:, :2] ** 2).sum(axis=1)) + 1e-12
        focal = min(model.cameras[model.images[index].camera_id].mean_focal_length() for index in (first, second))
        rows.append((place[first], place[second], len(matches), int((off * focal < EPIPOLAR_PIXELS).sum())))
    return np.array(rows, np.float64).reshape(-1, 4)


def _rays(model: Any, index: int, keypoints: Any) -> Floats:
    """(K, 3) of the keypoints of a picture, in its camera's frame, with z = 1."""
    import numpy as np

    camera = model.cameras[model.images[index].camera_id]
    flat = np.asarray(camera.cam_from_img(np.asarray(keypoints[:, :2], np.float64)), np.float64)
    return np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
