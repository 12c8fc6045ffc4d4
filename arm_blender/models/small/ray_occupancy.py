"""Where the object is along each ray of a view: what one picture shows of its shape, by what objects are like.

Not in the paper. GeoRM compares views; a single one leaves it the silhouette, solid from one wall of the box to the
other. How deep a thing is that is seen from its front must be known from other things: from its colours and shading,
where the edges of its top lie, that it stands upright in the middle of the box and that its longest side is mostly 2. A
2-D U-Net sees the view as a camera would that looks at the origin and holds the world's Z up, and says for every pixel
how deep its ray first meets the object and at last leaves it, how sure that is, and what else is on the way: an
occupancy over the view's frustum, which points look up.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...graphics.cameras import look_at
from ...graphics.silhouette_fill import filled
from ...graphics.visual_hull import NEAREST, VOTE_OUTSIDE, Outlines
from ...progress import Progress, silent
from ..encoded import Encoded
from ..network_views import NetworkViews
from ..unet import Unet, UnetConfig

LOCAL, WHOLE = 12, 9
"""Numbers that the network is given of a pixel: colour 3, coverage, distance to the outline 2, place 2, and where its
ray enters and leaves the box and meets the upright plane through the middle, how deep and how high; and of the whole
view: elevation, azimuth 2, nearness, the silhouette's 4 bounds and its area."""

BALL = 1.3
"""World units: radius of the ball around the origin that fills the network's picture. A full box has corners beyond."""

CARVED = 0.0
"""Logits taken from the network's before silhouettes are filled."""

REACH = 1.4
"""World units before and behind the origin's depth that the depths span."""


@dataclass(frozen=True)
class RayOccupancyConfig:
    """Of the network; there is one preset."""

    size: int = 128
    """Pixels a side of the picture that the network sees, twice a multiple of the U-Net's. A pixel is 0.02 world units.
    """
    unet: UnetConfig = UnetConfig(widths=(64, 96, 160, 256), out_channels=96, stem_stride=2)
    """What reads the picture, squares of two by two pixels at once; surfaces come out at twice its resolution."""
    depths: int = 48
    """Along a ray, 0.06 world units apart; between them occupancy is interpolated."""
    gain: float = 50.0
    """Logits for each world unit outside of the outline, which need not be learnt; and along a ray, at most, from where
    the object begins or ends."""
    image_size: int = 160
    """Pixels a side of the pictures that the network's own is taken from."""
    background: float = 1.0
    """Grey level (sRGB) behind the object in the pictures."""


@dataclass(frozen=True)
class Frustum:
    """A camera's that looks at the origin with the world's Z up, for N views.

    Attributes:
        rotation: (N, 3, 3) camera to world, OpenGL axes.
        eye: (N, 3) world.
        range: (N,) distance of the origin.
        half: (N,) half of the picture's side at the origin's depth, world units.
    """

    rotation: Tensor
    eye: Tensor
    range: Tensor
    half: Tensor

    @classmethod
    def of(cls, eye: Tensor) -> "Frustum":
        """That of cameras at `eye` (N, 3), filled by a ball of radius `BALL` around the origin."""
        rotation = torch.stack([look_at(one)[:3, :3] for one in eye.cpu()]).to(eye)
        distance = eye.norm(dim=1).clamp(min=NEAREST)
        # From within the ball nothing frames it; cameras stand outside of the box.
        away = distance.clamp(min=1.1 * BALL)
        return cls(rotation, eye, distance, BALL * distance / (away.square() - BALL**2).sqrt())

    def rays(self, size: int) -> Tensor:
        """(N, size * size, 3) world directions through the pixels' centres, row by row, one unit of depth long."""
        steps = ((torch.arange(size, device=self.eye.device) + 0.5) / size * 2.0 - 1.0).to(self.eye)
        y, x = torch.meshgrid(-steps, steps, indexing="ij")
        reach = (self.half / self.range)[:, None]
        local = torch.stack([x.flatten() * reach, y.flatten() * reach, -torch.ones_like(x.flatten() * reach)], dim=-1)
        return local @ self.rotation.transpose(1, 2)

    def grid(self, points: Tensor) -> Tensor:
        """(N, P, 3) where world points (N, P, 3) lie in a grid (depth, row, column), as grid_sample takes it."""
        local = (points - self.eye[:, None]) @ self.rotation
        depth = -local[..., 2:]
        scale = self.range / self.half
        across = local[..., :2] / depth.clamp(min=1e-2) * scale[:, None, None]
        flip = across.new_tensor([1.0, -1.0])
        return torch.cat([across * flip, (depth - self.range[:, None, None]) / REACH], dim=-1)


@dataclass(frozen=True)
class EncodedRays(Encoded):
    """What points are decoded from, of B objects in V views.

    Attributes:
        logits: (B * V, 1, D, h, w) over the frusta: positive where the object is.
        layers: (B * V, 2, h, w) depth beyond the origin's at which a ray first meets the object and at last leaves it.
        frusta: of those views.
        outlines: of the views.
    """

    logits: Tensor
    layers: Tensor
    frusta: Frustum
    outlines: Outlines


class RayOccupancy(nn.Module):
    """`encode` views once, then ask for the occupancy anywhere in the box."""

    def __init__(self, config: RayOccupancyConfig) -> None:
        super().__init__()
        self.config = config
        self.unet = Unet(4 * LOCAL + WHOLE, config.unet)
        # How deep the whole is, from its bounds: known long before the pixels agree on it.
        self.whole = nn.Sequential(nn.Linear(WHOLE, 64), nn.SiLU(), nn.Linear(64, 64), nn.SiLU(), nn.Linear(64, 4))
        layers = nn.Conv2d(config.unet.out_channels, 16, 1)
        depths = nn.Conv2d(config.unet.out_channels, config.depths, 1)
        self.layers = nn.Sequential(nn.SiLU(), layers, nn.PixelShuffle(2))
        self.depths = nn.Sequential(nn.SiLU(), depths)
        with torch.no_grad():  # Half as deep as the box at first, and not sure of it.
            assert layers.bias is not None
            layers.bias.copy_(torch.tensor([-0.5, 0.5, -1.5, -1.5]).repeat_interleave(4))
            for parameter in depths.parameters():
                parameter.zero_()

    def encode(self, views: NetworkViews) -> EncodedRays:
        """Everything that points are decoded from."""
        outlines = views.outlines
        frusta = Frustum.of(views.c2w[..., :3, 3].flatten(0, 1))
        seen = look(views, outlines, frusta, self.config.size, self.config.background)
        squares = F.pixel_unshuffle(seen[:, :LOCAL], 2)
        features = self.unet(torch.cat([squares, seen[:, LOCAL:, ::2, ::2]], dim=1))
        layers = (self.layers(features) + self.whole(seen[:, LOCAL:, 0, 0])[..., None, None]).float()
        first, last = (layers[:, side, None] for side in (0, 1))
        sharp = self.config.gain * layers[:, 2:].sigmoid()
        offsets = (torch.arange(self.config.depths, device=seen.device) + 0.5) / self.config.depths * 2.0 - 1.0
        at = REACH * offsets[:, None, None]
        # Between where its ray first meets the object and where it leaves it, and what is else on the way.
        slab = torch.minimum((at - first) * sharp[:, :1], (last - at) * sharp[:, 1:])
        others = F.interpolate(self.depths(features).float(), size=slab.shape[-2:], mode="bilinear")
        return EncodedRays((slab + others).unsqueeze(1), layers[:, :2], frusta, outlines)

    def occupancy_logit(self, encoded: EncodedRays, points: Tensor) -> Tensor:
        """(B, P) positive where the object is, at world points (B, P, 3): the mean over the views, cut by the hull."""
        batch, views = encoded.outlines.c2w.shape[:2]
        grid = encoded.frusta.grid(points.repeat_interleave(views, dim=0))
        found = F.grid_sample(encoded.logits, grid[:, :, None, None], padding_mode="border", align_corners=False)
        rays = found[:, 0, :, 0, 0].unflatten(0, (batch, views)).mean(dim=1)
        outside = encoded.outlines.hull_distance(points).clamp(-VOTE_OUTSIDE, 0.0)
        return rays + self.config.gain * outside

    def layers_at(self, encoded: EncodedRays, points: Tensor) -> tuple[Tensor, Tensor]:
        """What is said of the rays on which world points (B, P, 3) lie, of one view each (V = 1).

        Returns:
            (B, P, 2) depths beyond the origin's, world units, of the object's first and last surface; (B, P) those of
            the points.
        """
        grid = encoded.frusta.grid(points)
        found = F.grid_sample(encoded.layers, grid[:, :, None, :2], padding_mode="border", align_corners=False)
        return found[..., 0].transpose(1, 2), grid[..., 2] * REACH

    def filled_logit(self, encoded: EncodedRays, chunk: int, progress: Progress = silent) -> Callable[[Tensor], Tensor]:
        """The field whose surface is the object: (P, 3) world points to (P,), of one object, silhouettes filled.

        Args:
            chunk: points asked at once.
            progress: of filling the silhouettes.
        """

        def plain(points: Tensor) -> Tensor:
            return self.occupancy_logit(encoded, points[None])[0]

        return filled(plain, encoded.outlines, chunk, progress, CARVED)


def look(views: NetworkViews, outlines: Outlines, frusta: Frustum, size: int, background: float) -> Tensor:
    """What the network sees: (B * V, LOCAL + WHOLE, size, size).

    Args:
        background: grey level (sRGB) that the images are composited on.
    """
    count = len(frusta.eye)
    ends = frusta.eye[:, None] + frusta.rays(size) * frusta.range[:, None, None]
    one = outlines.apart()
    seen = one.project(ends)
    framed = seen.framed[..., None]
    images = views.images.flatten(0, 1).unsqueeze(1)
    found = (seen.sample(images) * framed)[:, 0]
    coverage = found[..., 3:]
    color = found[..., :3] - framed[:, 0] * background + coverage * (background - 0.5)
    pixels = torch.where(framed > 0, seen.sample(one.silhouette)[..., 1:], -1e3)[:, 0]
    distance = pixels * (one.range / one.K[..., 0, 0])[:, :, None]
    x = (torch.arange(size, device=color.device) + 0.5) / size * 2.0 - 1.0
    down, right = torch.meshgrid(x, x, indexing="ij")
    places = torch.stack([right, -down], dim=-1).flatten(0, 1).expand(count, -1, -1)
    inside = coverage[..., 0] > 0.5
    bounds = [torch.where(inside, way, -1.0).amax(dim=1) for way in (places[..., 0], -places[..., 0],
                                                                      places[..., 1], -places[..., 1])]  # fmt: skip
    toward = frusta.rotation[:, :, 2]
    angle = 4.0 * torch.atan2(toward[:, 0], -toward[:, 1])  # Most things stand along the axes.
    area = coverage[..., 0].mean(dim=1)
    same = torch.stack([toward[:, 2], angle.cos(), angle.sin(), 3.0 / frusta.range, *bounds, area], dim=-1)
    parts = [color, coverage, (distance / 0.05).tanh(), (distance / 0.3).tanh(), places, met(frusta, size)]
    cells = torch.cat([*parts, same[:, None].expand(-1, size * size, -1)], dim=-1)
    return cells.transpose(1, 2).unflatten(-1, (size, size))


def met(frusta: Frustum, size: int) -> Tensor:
    """(N, size * size, 4) where rays enter the box, leave it, and meet the upright plane through the origin that
    faces the camera: depths in units of `REACH`; and the height on that plane, world units."""
    rays, eye = frusta.rays(size), frusta.eye[:, None]
    slope = torch.where(rays.abs() < 1e-6, 1e-6, rays)
    walls = torch.stack([(-1.0 - eye) / slope, (1.0 - eye) / slope])
    box = torch.stack([walls.amin(dim=0).amax(dim=-1), walls.amax(dim=0).amin(dim=-1)], dim=-1)
    facing = F.normalize(frusta.rotation[:, None, :2, 2], dim=-1)  # From straight above any plane does.
    upright = -(eye[..., :2] * facing).sum(dim=-1) / (rays[..., :2] * facing).sum(dim=-1).clamp(max=-0.1)
    depth = torch.cat([box, upright.unsqueeze(-1)], dim=-1)
    height = eye[..., 2:] + upright.unsqueeze(-1) * rays[..., 2:]
    offset = (depth - frusta.range[:, None, None]) / REACH
    return torch.cat([offset, height], dim=-1).clamp(-1.5, 1.5)
