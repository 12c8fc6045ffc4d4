"""The weights that the program knows: its own, and those of other projects with where they are published."""

from dataclasses import dataclass

from ..machine.fetch import PublishedFile


@dataclass(frozen=True)
class Weights:
    """One entry of the registry.

    Attributes:
        name: preset and model, such as "small.georm".
        enables: what a user gets from it.
        licence: SPDX identifier of the weights, not of the code.
        remedy: what to do when the file is not there.
        kind: the word after `weights import FILE --as`; empty for what is not brought from elsewhere.
        files: that they are published in, all of them needed; empty where nobody publishes them.
        variants: names of other published files, each of which does as well once a user has it.
        gated: whether the publisher asks for an account first.
        suffix: of the installed file.
    """

    name: str
    enables: str
    licence: str
    remedy: str
    kind: str = ""
    files: tuple[PublishedFile, ...] = ()
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
        sizes = " and ".join(file.about for file in self.files)
        return f"{sizes}, {'with an account' if self.gated else 'no account'}" if sizes else ""

    @property
    def choices(self) -> tuple[tuple[str, ...], ...]:
        """The names of files that are known to be these weights, each choice enough by itself, the best first."""
        published = (tuple(file.name for file in self.files),) if self.files else ()
        return ((self.file_name,), *published, *((name,) for name in self.variants))


_SHIPPED = "install the project again, or train it: python -m training fit --help"
_OWN = "this preset ships without weights: train it (python -m training fit --help), or choose --preset small"
_BRING = "python -m arm_blender weights download {}, or bring {}: python -m arm_blender weights import FILE --as {}"


def _dino(encoder: str, network: str, patch: int) -> Weights:
    """DINO's ViT-B of that patch, with which the training of a network's encoder begins."""
    name, file = f"paper.{encoder}_encoder", f"dino_vitbase{patch}_pretrain"
    url = f"https://dl.fbaipublicfiles.com/dino/{file}/{file}.pth"
    return Weights(
        name,
        f"what training {network} at the paper's size begins with",
        "Apache-2.0",
        _BRING.format(name, f"DINO's ViT-B/{patch}", f"{encoder}-encoder"),
        kind=f"{encoder}-encoder",
        files=(PublishedFile(f"{file}.pth", url, "343 MB"),),
    )


REGISTRY = (
    Weights("small.georm", "geometry from views on a CPU", "GPL-3.0-or-later", _SHIPPED),
    Weights("small.finish", "roughness and metallic on a CPU", "GPL-3.0-or-later", _SHIPPED),
    Weights("small.instant_albedo", "albedo without the lighting on a CPU", "GPL-3.0-or-later", _SHIPPED),
    Weights("small.ray_occupancy", "geometry from one view or two on a CPU", "GPL-3.0-or-later", _SHIPPED),
    Weights("small.cutout", "cutting the object out of a photograph, on a CPU", "GPL-3.0-or-later", _SHIPPED),
    Weights("small.joint_cutout", "cutting the object out of photographs with cameras", "GPL-3.0-or-later", _SHIPPED),
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
        files=(
            PublishedFile(
                "instant_nerf_large.ckpt",
                "https://huggingface.co/TencentARC/InstantMesh/resolve/main/instant_nerf_large.ckpt",
                "1.5 GB",
                sha256="530a344ea9b856e012492b9644ab73532ddf7c06d548f60c489e49a528322fb9",
            ),
        ),
        variants=("instant_nerf_base.ckpt", "instant_mesh_large.ckpt", "instant_mesh_base.ckpt"),
    ),
    _dino("image", "GeoRM", 16),
    _dino("material", "InstantAlbedo", 8),
    Weights(
        "lpips.vgg",
        "the perceptual term of training: --lpips FILE",
        "BSD-3-Clause AND BSD-2-Clause",
        _BRING.format("lpips.vgg", "vgg16-397923af.pth and LPIPS's vgg.pth in one folder", "lpips").replace(
            "FILE", "FOLDER"
        ),
        kind="lpips",
        files=(
            PublishedFile(
                "vgg16-397923af.pth",
                "https://download.pytorch.org/models/vgg16-397923af.pth",
                "528 MiB",
                sha256="397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0",
            ),
            PublishedFile(
                "vgg.pth",
                "https://raw.githubusercontent.com/richzhang/PerceptualSimilarity/master/lpips/weights/v0.1/vgg.pth",
                "7 kB",
                size=7289,
                sha256="a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
            ),
        ),
    ),
    Weights(
        "matting",
        "cutting the object out of a photograph",
        "Apache-2.0",
        _BRING.format("matting", "a U2-Net or IS-Net as ONNX", "matting"),
        kind="matting",
        files=(
            PublishedFile(
                "u2net.onnx",
                "https://github.com/danielgatis/rembg/releases/download/v0.0.0/u2net.onnx",
                "176 MB",
                size=175_997_641,
                sha256="8d10d2f3bb75ae3b6d527c77944fc5e7dcd94b29809d47a739a7a728a912b491",
            ),
        ),
        # No download of ours: the publisher of IS-Net states no licence for its weights.
        variants=("isnet-general-use.onnx", "u2netp.onnx", "silueta.onnx"),
        suffix=".onnx",
    ),
)
