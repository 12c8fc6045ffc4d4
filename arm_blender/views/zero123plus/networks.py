"""The networks of Zero123++ v1.2 from a local folder, as diffusers saves a pipeline: no downloads, no pickles.

diffusers and transformers are imported when weights are read, not before.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from ...errors import ArmError, CheckpointError
from ...machine.config_json import config_from_dict
from .network_picture import PreprocessorConfig, preprocessor_config
from .schedule import NoiseConfig

EXTRA = "pip install 'diffusers>=0.35' 'transformers>=4.57'"
"""What to say where the optional extra is not installed; a test holds it to pyproject.toml."""

_NETWORKS = {
    "unet": ("diffusers", "UNet2DConditionModel", "diffusion_pytorch_model"),
    "vae": ("diffusers", "AutoencoderKL", "diffusion_pytorch_model"),
    "vision_encoder": ("transformers", "CLIPVisionModelWithProjection", "model"),
    "text_encoder": ("transformers", "CLIPTextModel", "model"),
}
"""Folder of each network: the library and the class that read it, and how its weights files begin."""

_FILES = (
    "model_index.json",
    "tokenizer/tokenizer_config.json",
    "scheduler/scheduler_config.json",
    "feature_extractor_clip/preprocessor_config.json",
    "feature_extractor_vae/preprocessor_config.json",
)

_UNREADABLE = (OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError, SafetensorError)
"""What the libraries raise for a damaged file, or for one of another model."""

_FOLDERS = "model_index.json, unet/, vae/, vision_encoder/, text_encoder/, tokenizer/, scheduler/, feature_extractor_*/"


@dataclass(frozen=True)
class Networks:
    """What makes six views of a picture.

    Attributes:
        unet: diffusers' UNet2DConditionModel, predicts v.
        vae: diffusers' AutoencoderKL.
        vision_encoder: transformers' CLIPVisionModelWithProjection.
        text_encoder: transformers' CLIPTextModel.
        empty_prompt: (1, L) int64 tokens of the empty prompt.
        ramp: (L,) how much of the picture's embedding is added to each token of the prompt.
        clip_picture: what `vision_encoder` takes.
        vae_picture: what `vae` takes; the image scaling is in it.
        noise: the training's noise levels.
    """

    unet: Any  # Of diffusers' classes a type checker finds a stand-in only.
    vae: Any
    vision_encoder: nn.Module
    text_encoder: nn.Module
    empty_prompt: Tensor
    ramp: Tensor
    clip_picture: PreprocessorConfig
    vae_picture: PreprocessorConfig
    noise: NoiseConfig

    @property
    def modules(self) -> tuple[nn.Module, ...]:
        """The four networks."""
        return self.unet, self.vae, self.vision_encoder, self.text_encoder


def check_model(folder: Path) -> None:
    """Makes sure, before any work starts, that the extra is installed and that `folder` has every part.

    Raises:
        ArmError: diffusers or transformers is not installed.
        CheckpointError: a part is missing, or there are pickled weights only; the line names it.
    """
    if not folder.is_dir():
        raise CheckpointError(
            f"{folder}: no such folder; put the weights of Zero123++ v1.2 there as diffusers saves them ({_FOLDERS})"
        )
    for name in (*_FILES, *(f"{network}/config.json" for network in _NETWORKS)):
        if not (folder / name).is_file():
            raise CheckpointError(f"{folder / name}: missing; copy the whole folder of the weights ({_FOLDERS})")
    for network, (_, _, stem) in _NETWORKS.items():
        if not any((folder / network).glob(f"{stem}*.safetensors")):
            raise CheckpointError(
                f"{folder / network}: no {stem}.safetensors; pickled weights are not read, convert them to safetensors"
            )
    _libraries()


def load_networks(folder: Path, device: torch.device | str) -> Networks:
    """Reads the networks: float16 on CUDA, float32 elsewhere; ready to run, without gradients.

    Args:
        folder: as diffusers saves a pipeline; see `check_model`.
        device: where they run.
    Raises:
        ArmError: as `check_model`.
        CheckpointError: a file is damaged, or belongs to another model.
    """
    check_model(folder)
    dtype = torch.float16 if torch.device(device).type == "cuda" else torch.float32
    with _silent_libraries():
        networks = {name: _network(folder / name).to(device, dtype) for name in _NETWORKS}
        prompt = _empty_prompt(folder / "tokenizer")
    index, scheduler = _json(folder / "model_index.json"), _json(folder / "scheduler/scheduler_config.json")
    try:
        ramp = torch.tensor(index["ramping_coefficients"], dtype=dtype, device=device)
        if ramp.shape != prompt.shape[1:]:
            raise ValueError(f"{tuple(ramp.shape)} ramping_coefficients for {prompt.shape[1]} tokens")
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(
            f"{folder}/model_index.json: ramping_coefficients ({error}); copy the file of Zero123++ v1.2"
        ) from error
    return Networks(
        **networks,
        empty_prompt=prompt.to(device),
        ramp=ramp,
        clip_picture=_picture(folder / "feature_extractor_clip/preprocessor_config.json"),
        vae_picture=_picture(folder / "feature_extractor_vae/preprocessor_config.json"),
        noise=_noise(scheduler, folder / "scheduler/scheduler_config.json"),
    )


def _network(folder: Path) -> nn.Module:
    """One network, every weight of it from its file."""
    library, name, _ = _NETWORKS[folder.name]
    wish = {"local_files_only": True, "use_safetensors": True, "output_loading_info": True}
    if library == "diffusers":
        wish["low_cpu_mem_usage"] = False  # What is lower would need another package.
    try:
        network, info = getattr(_libraries()[library], name).from_pretrained(str(folder), **wish)
    except _UNREADABLE as error:
        raise CheckpointError(f"{folder}: cannot be read ({error}); copy the folder of the weights again") from error
    wrong = [*map(str, info["missing_keys"]), *map(str, info["mismatched_keys"])]
    if wrong:
        # The libraries would leave them random, and warn.
        raise CheckpointError(
            f"{folder}: {len(wrong)} weights are missing or of another shape, as {wrong[0]}; copy it again"
        )
    return network.eval().requires_grad_(False)


def _empty_prompt(folder: Path) -> Tensor:
    """(1, L) tokens of the empty prompt, padded to the length of the training."""
    try:
        tokenizer = _libraries()["transformers"].CLIPTokenizer.from_pretrained(str(folder), local_files_only=True)
        tokens = tokenizer("", padding="max_length", max_length=tokenizer.model_max_length, truncation=True)
    except _UNREADABLE as error:
        raise CheckpointError(f"{folder}: cannot be read ({error}); copy the folder of the weights again") from error
    return torch.tensor([tokens["input_ids"]])


def _picture(path: Path) -> PreprocessorConfig:
    try:
        return preprocessor_config(_json(path))
    except ValueError as error:
        raise CheckpointError(f"{path}: {error}; copy the file of Zero123++ v1.2") from error


def _noise(values: dict[str, Any], path: Path) -> NoiseConfig:
    """The noise levels of a scheduler_config.json, whichever the sampler that it names."""
    try:
        if values.get("prediction_type") != "v_prediction" or values.get("rescale_betas_zero_snr"):
            raise ValueError(f"prediction_type {values.get('prediction_type')!r}, without rescale_betas_zero_snr")
        return config_from_dict(NoiseConfig, {key: values[key] for key in NoiseConfig.__dataclass_fields__})
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path}: {error}; copy the file of Zero123++ v1.2") from error


def _json(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: cannot be read ({error}); copy the file again") from error
    if not isinstance(values, dict):
        raise CheckpointError(f"{path}: holds no JSON object; copy the file again")
    return values


def _libraries() -> dict[str, Any]:
    """diffusers and transformers, with the classes that are needed.

    Raises:
        ArmError: one is missing, or does not start.
    """
    try:
        import diffusers
        import transformers

        found = {"diffusers": diffusers, "transformers": transformers}
        for library, name, _ in _NETWORKS.values():
            getattr(found[library], name)  # Both libraries import a class when it is asked for.
    except (ImportError, RuntimeError, AttributeError) as error:
        raise ArmError(f"--multiview zero123plus: {error}; {EXTRA}") from error
    return found


@contextmanager
def _silent_libraries() -> Iterator[None]:
    """Keeps the libraries' progress bars and warnings off the terminal; what matters of them becomes an error."""
    logs = [library.utils.logging for library in _libraries().values()]
    levels = [log.get_verbosity() for log in logs]
    bars = [log.is_progress_bar_enabled() for log in logs]
    for log in logs:
        log.set_verbosity_error()
        log.disable_progress_bar()
    try:
        yield
    finally:
        for log, level, bar in zip(logs, levels, bars, strict=True):
            log.set_verbosity(level)
            if bar:
                log.enable_progress_bar()
