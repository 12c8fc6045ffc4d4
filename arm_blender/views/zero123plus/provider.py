"""`zero123plus`: six views of one picture, written into a folder and read from there like a user's own."""

from pathlib import Path

from ...machine.threads import cpu_threads
from ...progress import Progress, part
from .. import preprocess
from ..foreground import Heard, unheard
from ..mask_files import mask_beside, read_cut_out
from ..multiview import View, posed_views
from ..rigs import AZIMUTHS_DEG, zero123plus_rig
from ..transforms_json import TRANSFORMS
from .networks import check_model, load_networks
from .sampling import Zero123PlusConfig, six_views
from .view_folder import check_folder, read_seeds, write_views
from .view_noise import ViewNoise


def drawn_views(
    path: Path,
    config: Zero123PlusConfig,
    distance: float,
    fovy_deg: float | None,
    progress: Progress,
    heard: Heard = unheard,
) -> list[View]:
    """The six views that Zero123++ draws of the picture at `path`, as `config.folder` holds them afterwards.

    Its networks are in memory while it draws, and no longer.

    Raises:
        ArmError: the optional extra is not installed.
        CheckpointError: weights are missing, damaged, or of another model.
        InputImageError: the picture does not do, or a view's background is not plain: it is in the folder.
        OutputError: the folder cannot be written.
        Cancelled: by `progress`; the folder is as it was.
    """
    check_folder(config.folder)
    check_model(config.model)
    seeds = _seeds(config)
    progress(0.0, f"reading {path.name}")
    picture, _, _ = preprocess.crop_single(read_cut_out(path, mask_beside(path, path.parent), heard), path)
    progress(0.0, "Zero123++: reading the weights")
    networks = load_networks(config.model, config.device)
    with cpu_threads(config.threads):
        images = six_views(networks, picture, config, ViewNoise(seeds), part(progress, 0.0, 0.95))
    del networks  # Gigabytes, which the reconstruction has better use for.
    wanted = config.reseed or range(len(seeds))
    cameras = zero123plus_rig(distance, 30.0 if fovy_deg is None else fovy_deg, config.side)
    origin = {"steps": config.steps, "guidance": config.guidance, "background": config.background}
    progress(0.95, f"writing {config.folder.name}")
    write_views(config.folder, {index: images[index] for index in wanted}, cameras, seeds, **origin)
    return posed_views(config.folder / TRANSFORMS, part(progress, 0.95, 1.0), heard)


def _seeds(config: Zero123PlusConfig) -> tuple[int, ...]:
    """The seed of each view: the run's own, or for those that are kept the one that they were drawn with."""
    if not config.reseed:
        return (config.seed,) * len(AZIMUTHS_DEG)
    kept = read_seeds(config.folder)
    return tuple(config.seed if index in config.reseed else seed for index, seed in enumerate(kept))
