"""What the stages of the pipeline hand to each other: frozen, with every shape, unit and space stated."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import torch
from torch import Tensor

from .graphics.borders import Rectangle
from .graphics.cameras import Camera, directions_to
from .knobs.finishes import Finish


@dataclass(frozen=True)
class ViewSet:
    """Posed views of one object; all of one size.

    Attributes:
        images: (V, 4, H, W) float32 in [0, 1]: linear Rec.709 and straight alpha.
        cameras: V cameras of that size.
        weights: (V,) float32 >= 0: how much each view counts in the texture; 1 by default.
        name: what the result is called.
        known: of each view the pixels that a camera took, where others were added around them; None where none were.
        ground: height (world Z) of what the object stands on, where that is known.
        varying_exposure: the camera exposed by itself, each view for it alone.
        length: how long the object's longest side is to become, in units of the result; None leaves it as it is seen.
        pictures: of each view the name of its picture, for messages; None where they have none.
    """

    images: Tensor
    cameras: tuple[Camera, ...]
    weights: Tensor
    name: str
    known: tuple[Rectangle, ...] | None = None
    ground: float | None = None
    varying_exposure: bool = False
    length: float | None = None
    pictures: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        views = self.images.shape[0]
        if self.images.ndim != 4 or self.images.shape[1] != 4:
            raise ValueError(f"images must be (V, 4, H, W), got {tuple(self.images.shape)}")
        if len(self.cameras) != views or self.weights.shape != (views,):
            raise ValueError(f"{views} views, {len(self.cameras)} cameras, weights {tuple(self.weights.shape)}")
        if self.known is not None and len(self.known) != views:
            raise ValueError(f"{views} views, known pixels of {len(self.known)}")

    @property
    def called(self) -> tuple[str, ...]:
        """Of each view what a message calls it."""
        return self.pictures or tuple(f"view {index}" for index in range(len(self.cameras)))

    @property
    def rectangles(self) -> tuple[Rectangle, ...]:
        """Of each view the pixels that a camera took."""
        height, width = self.images.shape[2:]
        return ((0, 0, width, height),) * len(self.cameras) if self.known is None else self.known

    def to(self, device: torch.device | str) -> "ViewSet":
        """The same on another device."""
        cameras = tuple(camera.to(device) for camera in self.cameras)
        return replace(self, images=self.images.to(device), cameras=cameras, weights=self.weights.to(device))

    def chosen(self) -> "ViewSet":
        """Without the views of weight 0: they shape nothing and colour nothing."""
        return self.only([index for index, weight in enumerate(self.weights.tolist()) if weight > 0.0])

    def only(self, indices: Sequence[int]) -> "ViewSet":
        """The views with these indices, in this order."""
        keep = list(indices)
        cameras = tuple(self.cameras[i] for i in keep)
        known = None if self.known is None else tuple(self.known[i] for i in keep)
        pictures = None if self.pictures is None else tuple(self.pictures[i] for i in keep)
        images, weights = self.images[keep], self.weights[keep]
        return replace(self, images=images, cameras=cameras, weights=weights, known=known, pictures=pictures)


@dataclass(frozen=True)
class TriangleMesh:
    """A welded triangle mesh; outward winding is counter-clockwise.

    Attributes:
        vertices: (N, 3) float32, world.
        faces: (F, 3) int64, indices into `vertices`.
    """

    vertices: Tensor
    faces: Tensor

    def __post_init__(self) -> None:
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3 or self.faces.ndim != 2 or self.faces.shape[1] != 3:
            raise ValueError(f"vertices (N, 3), faces (F, 3), got {self.vertices.shape}, {self.faces.shape}")

    def to(self, device: torch.device | str) -> "TriangleMesh":
        """The same on another device."""
        return TriangleMesh(self.vertices.to(device), self.faces.to(device))

    def moved(self, motion: Callable[[Tensor], Tensor]) -> "TriangleMesh":
        """The mesh with `motion` applied to its vertices (N, 3)."""
        return replace(self, vertices=motion(self.vertices))


@dataclass(frozen=True)
class UvMesh:
    """A welded triangle mesh with an atlas. UVs live on corners, so that seams do not tear the mesh.

    Attributes:
        vertices: (N, 3) float32, world.
        faces: (F, 3) int64, indices into `vertices`.
        uvs: (M, 2) float32 in [0, 1], v up.
        face_uvs: (F, 3) int64, indices into `uvs`.
        charts: number of charts.
    """

    vertices: Tensor
    faces: Tensor
    uvs: Tensor
    face_uvs: Tensor
    charts: int

    def __post_init__(self) -> None:
        if self.faces.shape != self.face_uvs.shape:
            raise ValueError(f"faces {tuple(self.faces.shape)} and face_uvs {tuple(self.face_uvs.shape)} differ")

    def to(self, device: torch.device | str) -> "UvMesh":
        """The same on another device."""
        return UvMesh(
            self.vertices.to(device), self.faces.to(device), self.uvs.to(device), self.face_uvs.to(device), self.charts
        )

    def moved(self, motion: Callable[[Tensor], Tensor]) -> "UvMesh":
        """The mesh with `motion` applied to its vertices (N, 3)."""
        return replace(self, vertices=motion(self.vertices))


@dataclass(frozen=True)
class TexelMap:
    """The surface point of every texel; row 0 is v = 1.

    Attributes:
        position: (3, T, T) world; 0 where no chart lies.
        normal: (3, T, T) unit, smooth; 0 where no chart lies.
        mask: (T, T) bool: a chart covers the texel's centre.
    """

    position: Tensor
    normal: Tensor
    mask: Tensor


@dataclass(frozen=True)
class TexelViews:
    """What each view says of each texel (ARM, section 5.2); 0 wherever `visibility` is False.

    Attributes:
        color: (V, 3, T, T) linear Rec.709.
        visibility: (V, T, T) bool: seen unoccluded, not grazing, inside the silhouette.
        eyes: (V, 3) where the cameras are, world.
        cosine: (V, T, T) in [0, 1]: n.v.
        pixels: (V, T, T, 2) where the texel lies in the view, pixels; meaningless where not visible.
    """

    color: Tensor
    visibility: Tensor
    eyes: Tensor
    cosine: Tensor
    pixels: Tensor

    @property
    def seen(self) -> Tensor:
        """(T, T) bool: at least one view sees the texel."""
        return self.visibility.any(dim=0)

    def direction(self, view: int, position: Tensor) -> Tensor:
        """(3, T, T) unit, from the surface at `position` (3, T, T) to a view; 0 where the view does not see it.

        Not stored: of all views together it would be the largest part.
        """
        towards = directions_to(self.eyes[view], position.permute(1, 2, 0)).permute(2, 0, 1)
        return torch.where(self.visibility[view], towards, 0.0)

    def only(self, views: Tensor) -> "TexelViews":
        """What some of the views say: (V,) bool, or indices of views."""
        return TexelViews(*(getattr(self, entry.name)[views] for entry in fields(self)))


VALUE_SIDE = 4
"""Texels a side of a map that is one value, where it has to be an image."""


@dataclass(frozen=True)
class Regions:
    """The parts of an object that have one finish each, and the finishes that a user has set.

    Attributes:
        index: (T, T) uint8, 1 to N, the region of every texel, padded beyond the charts as the maps are; row 0 is
            v = 1. Regions are numbered by their area, the largest first.
        area: N shares of the surface, in (0, 1].
        swatch: N mean albedos, linear Rec.709.
        light: linear Rec.709 > 0: the light of the views, the baked colour over the albedo in the mean of the surface.
        finishes: those that were set, by the number of the region; the others are as predicted.
    """

    index: Tensor
    area: tuple[float, ...]
    swatch: tuple[tuple[float, float, float], ...]
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)
    finishes: Mapping[int, Finish] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.index.ndim != 2 or self.index.dtype != torch.uint8 or len(self.area) != len(self.swatch):
            raise ValueError(f"index (T, T) uint8, got {tuple(self.index.shape)}, {self.index.dtype}")
        if not all(1 <= number <= self.count for number in self.finishes):
            raise ValueError(f"{self.count} regions, finishes of {sorted(self.finishes)}")

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.area)

    def to(self, device: torch.device | str) -> "Regions":
        """The same on another device."""
        return replace(self, index=self.index.to(device))


@dataclass(frozen=True)
class MaterialMaps:
    """Maps of one atlas; row 0 is v = 1. Gaps between charts are padded with the nearest covered texel.

    Albedo and baked colour have T texels a side; roughness and metallic may have fewer, or be one value. All are as
    predicted; what a user has set by hand stands in `regions`, and `uv.finish.finished` makes the maps that show it.

    Attributes:
        albedo: (3, T, T) linear Rec.709 in [0, 1]; the base colour, not multiplied by (1 - metallic).
        baked: (3, T, T) linear Rec.709 in [0, 1]: colour with the lighting of the views in it.
        roughness: (1, T, T) in [0, 1], perceptual (alpha = roughness**2), or the one value of all texels.
        metallic: (1, T, T) in [0, 1], or the one value.
        normal: (3, T, T) unit vectors in tangent space (`uv.normal_map`); None where the mesh's own will do.
        regions: parts of one finish; None where the maps were not cut into any.
        light: (9, 3) of the views, by which the albedo was found, as of `spherical_harmonics.gathered`; None where the
            networks find none.
    """

    albedo: Tensor
    baked: Tensor
    roughness: Tensor | float
    metallic: Tensor | float
    normal: Tensor | None = None
    regions: Regions | None = None
    light: Tensor | None = None

    def to(self, device: torch.device | str) -> "MaterialMaps":
        """The same on another device."""

        def moved(entry: Any) -> Any:
            return entry.to(device) if isinstance(entry, Tensor | Regions) else entry

        return MaterialMaps(*(moved(getattr(self, entry.name)) for entry in fields(self)))

    def image(self, name: str, side: int = VALUE_SIDE) -> Tensor:
        """(C, T, T) of the map of that name; one that is a value is spread out over `side` texels a side."""
        texels = getattr(self, name)
        return self.albedo.new_full((1, side, side), texels) if isinstance(texels, float) else texels


@dataclass(frozen=True)
class RelightableAsset:
    """The result: a mesh and what it takes to light it anew.

    Attributes:
        name: of the object and its files.
        mesh: with its atlas.
        maps: material maps on that atlas.
        comparison: (3, H, W) uint8 sRGB, the views beside the asset under their light (`light_check`); None without.
    """

    name: str
    mesh: UvMesh
    maps: MaterialMaps
    comparison: Tensor | None = None

    def to(self, device: torch.device | str) -> "RelightableAsset":
        """The same on another device."""
        return replace(self, mesh=self.mesh.to(device), maps=self.maps.to(device))


def stack_cameras(cameras: Sequence[Camera]) -> tuple[Tensor, Tensor]:
    """(V, 4, 4) c2w and (V, 3, 3) K of V cameras."""
    return torch.stack([c.c2w for c in cameras]), torch.stack([c.K for c in cameras])
