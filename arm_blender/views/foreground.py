"""What of a picture is the object: its alpha, or where it has none, the first of several ways that is sure of it."""

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from ..errors import InputImageError
from ..report import DOUBTFUL
from .cutout import cut_out
from .masks import Unsure, doubt, sees_something, shreds
from .matting import matted_by_model, matted_by_rembg
from .opacity import solid
from .plain_background import plain_foreground
from .preprocess import check_size, limit_size

Heard = Callable[[str, str], None]
"""Is told of each picture, by its name, which way its mask was found, and again what is doubtful about it;
`Report.note_mask` is one."""

WAYS: dict[str, Callable[[Tensor], Tensor]] = {
    "matting model": matted_by_model,
    "rembg": matted_by_rembg,
    "plain background": plain_foreground,
    "small network": cut_out,
}
"""How the mask (H, W) of a picture (4, H, W) without alpha is found, in this order."""


def unheard(picture: str, way: str) -> None:
    """The `Heard` that tells nobody."""


def foreground(image: Tensor, path: Path, heard: Heard = unheard) -> Tensor:
    """`image` (4, H, W) with an alpha that cuts the object out, linear Rec.709.

    A picture with alpha keeps it, brought to a scale on which the object is opaque (`opacity.solid`); an opaque one,
    and one whose alpha is of all of it, gets that of the first way that is sure, found at the size that views keep at
    most.

    Args:
        path: of the picture, for messages.
        heard: is told which way it was: "alpha", or one of `WAYS`; and where the mask found is doubtful, why.
    Raises:
        InputImageError: opaque, and no way is sure; or too small.
        CheckpointError: a matting model is there, but damaged.
    """
    check_size(image, path)
    if bool((image[3] < 0.5).any()):
        alpha = image[3]
        own = solid(alpha)
        if own is alpha:
            heard(path.name, "alpha")
            return image
        if bool((own < 0.5).any()):
            heard(path.name, "alpha")
            heard(path.name, f"{DOUBTFUL}the object is see-through, and the asset will be opaque")
            return torch.cat([image[:3], own[None]])
        image = torch.cat([image[:3], torch.ones_like(image[3:])])
    doubts, limited = [], limit_size(image, path)
    for way, find in WAYS.items():
        try:
            alpha = find(limited)
        except Unsure as unsure:
            doubts.append(str(unsure))
            continue
        if torn := shreds(alpha):
            doubts.append(f"what the {way} found is no object: {torn}")
            continue
        if sees_something(alpha) and not bool((alpha > 0.5).all()):
            heard(path.name, way)
            if why := doubt(alpha):
                heard(path.name, f"{DOUBTFUL}{why}")
            alpha = alpha[None].to(image)
            if limited is not image:
                alpha = interpolate(alpha[None], size=image.shape[1:], mode="bilinear")[0]
            return torch.cat([image[:3], alpha])
        doubts.append(f"by {way} all or nothing is the object")
    raise InputImageError(
        f"{path}: no foreground found ({'; '.join(doubts)}); supply an image with alpha, or one on a plain background, "
        f"paint its mask beside it as {path.stem}.mask.png, "
        "or get a matting model: python -m arm_blender weights download matting"
    )
