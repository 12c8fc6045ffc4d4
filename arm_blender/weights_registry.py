"""The weights that the program knows: its own, and those of other projects with where they are published."""

from dataclasses import dataclass

from .fetch import PublishedFile


@dataclass(frozen=True)
class Weights:
    """One entry of the registry.

    Attributes:
        name: preset and model, such as "small.georm".
        enables: what a user gets from it.
        licence: SPDX identifier of the weights, not of the code.
        remedy: what to do when the file is not there.
        kind: the word after `weights import FILE --as`; empty for what is not brought from elsewhere.
        file: where they are published; None where nobody does.
        variants: names of other published files that do as well, once a user has them.
        gated: whether the publisher asks for an account first.
        suffix: of the installed file.
    """

    name: str
    enables: str
    licence: str
    remedy: str
    kind: str = ""
    file: PublishedFile | None = None
    variants: tuple[str, ...] = ()
    gated: bool = False
    suffix: str = ".safetensors"

    @property
    def file_name(self) -> str:
        """Of the installed file."""
        return f"{self.name}{self.suffix}"

    @property
    def download(self) -> str:
        """Size of what has to be brought, and whether that takes an account; empty where nothing has to."""
        return f"{self.file.about}, {'with an account' if self.gated else 'no account'}" if self.file else ""

    @property
    def names(self) -> tuple[str, ...]:
        """By which a file of a user is known to be these weights, the best first."""
        return (self.file_name, *([self.file.name] if self.file else []), *self.variants)


_SHIPPED = "install the project again, or train it: python -m training fit --help"
_OWN = "this preset ships without weights: train it (python -m training fit --help), or choose --preset small"
_BRING = "python -m arm_blender weights download {}, or bring {}: python -m arm_blender weights import FILE --as {}"
_DINO = "https://dl.fbaipublicfiles.com/dino"

REGISTRY = (
    Weights("small.georm", "geometry from views on a CPU", "GPL-3.0-or-later", _SHIPPED),
    Weights("small.glossyrm", "roughness and metallic on a CPU", "GPL-3.0-or-later", _SHIPPED),
    Weights("small.instant_albedo", "albedo without the lighting on a CPU", "GPL-3.0-or-later", _SHIPPED),
    Weights("paper.georm", "geometry at the paper's size", "your own", _OWN),
    Weights("paper.glossyrm", "roughness and metallic at the paper's size", "your own", _OWN),
    Weights("paper.instant_albedo", "albedo at the paper's size", "your own", _OWN),
    Weights(
        "instantmesh.georm",
        "geometry by InstantMesh's network",
        "CC-BY-NC-4.0",
        _BRING.format("instantmesh.georm", "InstantMesh's instant_nerf_large.ckpt", "georm")
        + ", or choose --preset small",
        kind="georm",
        file=PublishedFile(
            "instant_nerf_large.ckpt",
            "https://huggingface.co/TencentARC/InstantMesh/resolve/main/instant_nerf_large.ckpt",
            "1.5 GB",
            sha256="530a344ea9b856e012492b9644ab73532ddf7c06d548f60c489e49a528322fb9",
        ),
        variants=("instant_nerf_base.ckpt", "instant_mesh_large.ckpt", "instant_mesh_base.ckpt"),
    ),
    Weights(
        "paper.image_encoder",
        "what training GeoRM at the paper's size begins with",
        "Apache-2.0",
        _BRING.format("paper.image_encoder", "DINO's ViT-B/16", "image-encoder"),
        kind="image-encoder",
        file=PublishedFile(
            "dino_vitbase16_pretrain.pth", f"{_DINO}/dino_vitbase16_pretrain/dino_vitbase16_pretrain.pth", "343 MB"
        ),
    ),
    Weights(
        "paper.material_encoder",
        "what training InstantAlbedo at the paper's size begins with",
        "Apache-2.0",
        _BRING.format("paper.material_encoder", "DINO's ViT-B/8", "material-encoder"),
        kind="material-encoder",
        file=PublishedFile(
            "dino_vitbase8_pretrain.pth", f"{_DINO}/dino_vitbase8_pretrain/dino_vitbase8_pretrain.pth", "343 MB"
        ),
    ),
    Weights(
        "matting",
        "cutting the object out of a photograph",
        "Apache-2.0",
        _BRING.format("matting", "a U2-Net or IS-Net as ONNX", "matting"),
        kind="matting",
        file=PublishedFile(
            "u2net.onnx",
            "https://github.com/danielgatis/rembg/releases/download/v0.0.0/u2net.onnx",
            "176 MB",
            size=175_997_641,
            sha256="8d10d2f3bb75ae3b6d527c77944fc5e7dcd94b29809d47a739a7a728a912b491",
        ),
        # No download of ours: the publisher of IS-Net states no licence for its weights.
        variants=("isnet-general-use.onnx", "u2netp.onnx", "silueta.onnx"),
        suffix=".onnx",
    ),
)
