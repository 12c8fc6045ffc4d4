"""A tiny random pipeline of the real classes, saved by them as diffusers saves a pipeline."""

import json
import shutil
from pathlib import Path

import pytest
import torch

from arm_blender.views.zero123plus.networks import load_networks

TOKENS, WIDTH = 7, 12
CLIP = {"num_hidden_layers": 2, "num_attention_heads": 2, "hidden_size": WIDTH, "intermediate_size": 24}


def save_tiny(folder: Path) -> None:
    """Weights at random, but for the scale of the VAE's last layer: views that are not all grey."""
    diffusers, transformers = pytest.importorskip("diffusers"), pytest.importorskip("transformers")
    transformers.utils.logging.set_verbosity_error()
    transformers.utils.logging.disable_progress_bar()
    torch.manual_seed(0)
    unet = diffusers.UNet2DConditionModel(
        sample_size=8,
        block_out_channels=(8, 16),
        layers_per_block=1,
        down_block_types=("CrossAttnDownBlock2D", "DownBlock2D"),
        up_block_types=("UpBlock2D", "CrossAttnUpBlock2D"),
        cross_attention_dim=WIDTH,
        attention_head_dim=(2, 4),
        norm_num_groups=4,
        use_linear_projection=True,
    )
    vae = diffusers.AutoencoderKL(
        block_out_channels=(8, 8),
        down_block_types=("DownEncoderBlock2D",) * 2,
        up_block_types=("UpDecoderBlock2D",) * 2,
        latent_channels=4,
        norm_num_groups=4,
    )
    with torch.no_grad():
        vae.decoder.conv_out.weight *= 3.0
    vision = transformers.CLIPVisionModelWithProjection(
        transformers.CLIPVisionConfig(image_size=16, patch_size=8, projection_dim=WIDTH, **CLIP)
    )
    words = ["<|startoftext|>", "<|endoftext|>", "!", "a", "a</w>"]
    text = transformers.CLIPTextModel(
        transformers.CLIPTextConfig(vocab_size=len(words), max_position_embeddings=TOKENS, eos_token_id=1, **CLIP)
    )
    for name, network in {"unet": unet, "vae": vae, "vision_encoder": vision, "text_encoder": text}.items():
        network.save_pretrained(folder / name)
    save_tokenizer(folder / "tokenizer", words)
    diffusers.EulerAncestralDiscreteScheduler(
        beta_start=0.00085, beta_end=0.012, prediction_type="v_prediction", steps_offset=1
    ).save_pretrained(folder / "scheduler")
    for name, side, mean, std in (("clip", 16, 0.45, 0.27), ("vae", 24, 0.5, 0.8)):
        image_processor(side, mean, std).save_pretrained(folder / f"feature_extractor_{name}")
    index = {"_class_name": "Zero123PlusPipeline", "ramping_coefficients": torch.linspace(0.0, 1.0, TOKENS).tolist()}
    (folder / "model_index.json").write_text(json.dumps(index))


def save_tokenizer(folder: Path, words: list[str]) -> None:
    folder.mkdir()
    (folder / "vocab.json").write_text(json.dumps({word: index for index, word in enumerate(words)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = pytest.importorskip("transformers").CLIPTokenizer.from_pretrained(
        str(folder), pad_token="!", model_max_length=TOKENS
    )
    tokenizer.save_pretrained(folder)


def image_processor(side: int, mean: float, std: float):
    """transformers' own, without torchvision: the twin of our scaling."""
    return pytest.importorskip("transformers").CLIPImageProcessor(
        size={"shortest_edge": side},
        crop_size={"height": side, "width": side},
        image_mean=[mean] * 3,
        image_std=[std] * 3,
    )


@pytest.fixture(scope="session")
def tiny(tmp_path_factory) -> Path:
    """The folder of the pipeline; for reading only."""
    folder = tmp_path_factory.mktemp("zero123plus") / "tiny"
    folder.mkdir()
    save_tiny(folder)
    return folder


@pytest.fixture(scope="session")
def picture() -> torch.Tensor:
    """(4, 40, 40) linear RGBA: a disc whose colour runs across it."""
    rows, columns = torch.meshgrid(torch.arange(40.0), torch.arange(40.0), indexing="ij")
    alpha = ((rows - 20.0) ** 2 + (columns - 20.0) ** 2 < 17.0**2).float()
    return torch.stack([rows / 40.0, columns / 40.0, 1.0 - rows / 40.0, alpha])


@pytest.fixture
def own(tiny, tmp_path) -> Path:
    """A copy of the pipeline, to be broken."""
    return shutil.copytree(tiny, tmp_path / "weights")


@pytest.fixture(scope="session")
def networks(tiny):
    """The pipeline as it is read; for running only."""
    return load_networks(tiny, "cpu")
