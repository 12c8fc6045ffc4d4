"""Weights on disk: safetensors with the model's config inside, and the list of what this project ships.

A checkpoint is whole and self-describing, or it is refused: an unknown config key, another model, a missing or
wrongly shaped tensor each end in a `CheckpointError` that names the file and the remedy.
"""

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any, Literal

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor, nn

from ..errors import CheckpointError
from ..machine.config_json import Config, config_from_dict
from ..machine.files import whole_file
from .folder import folder_of
from .registry import REGISTRY as REGISTRY
from .registry import Weights

FORMAT = "arm_blender/1"
"""Stands in every file; a file without it was written by another program."""

SUMS = "SHA256SUMS"
"""Lies beside the weights that ship, and has their hashes."""

SUM = ".sha256"
"""What a user brings has its hash in a file of its own, named as the weights with this behind."""

_KINDS = {"F64", "F32", "F16", "BF16", "I64", "I32", "I16", "I8", "U8", "BOOL"}
"""Types of tensors, by the names of safetensors, that are read."""

SUFFIX = ".safetensors"
"""Of the files that this module writes; others that it records are opaque to it."""


def save(
    path: Path,
    state: dict[str, Tensor],
    config: Any,
    name: str,
    metadata: dict[str, str] | None = None,
    half: bool = False,
) -> None:
    """Write a checkpoint whole or not at all.

    Args:
        path: of the .safetensors file; its folder is made.
        state: a module's state dict.
        config: the frozen dataclass that the module was built from.
        name: of the model, such as "georm".
        metadata: strings that go into the header (data, steps, licence).
        half: store floating-point tensors as float16.
    Raises:
        ValueError: a value is not finite, or does not fit into float16.
        OutputError: the file cannot be written.
    """
    tensors, places = {}, set()
    for key, tensor in state.items():
        stored = tensor.detach().cpu().contiguous()
        if stored.is_floating_point():
            stored = stored.to(torch.float16 if half else torch.float32)
            if not _is_finite(stored):
                raise ValueError(f"{key}: a value is not finite in {stored.dtype}")
        # Tied weights share memory, which safetensors refuses: all but the first get their own.
        place = stored.untyped_storage().data_ptr()
        tensors[key] = stored.clone() if place in places else stored
        places.add(place)
    header = dict(metadata or {})
    header |= {"format": FORMAT, "name": name, "type": type(config).__name__}
    header["config"] = json.dumps(dataclasses.asdict(config), sort_keys=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_bytes(to_bytes(tensors, header))


def load(path: Path, *expected: type[Config]) -> tuple[Config, dict[str, Tensor]]:
    """The config, of one of the expected types, and the state dict of a checkpoint; floating-point tensors as float32.

    Raises:
        CheckpointError: the file is missing, damaged, or made for another model or version.
    """
    header = read_header(path)
    named = {kind.__name__: kind for kind in expected}
    if header["type"] not in named:
        raise CheckpointError(
            f"{path}: holds the model {header['name']!r} ({header['type']}), but {' or '.join(named)} is needed; "
            "choose the file made for this model"
        )
    try:
        config = config_from_dict(named[header["type"]], json.loads(header["config"]))
    except (ValueError, TypeError, RecursionError) as error:
        raise CheckpointError(
            f"{path}: {error}; the file was made by another version, get one made for this"
        ) from error
    try:
        with safe_open(path, framework="pt") as file:
            state = tensors_in(file, path)
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path}: damaged ({error}); copy the file again") from error
    for key, tensor in state.items():
        if tensor.is_floating_point() and not _is_finite(tensor):
            raise CheckpointError(f"{path}: damaged ({key} is not finite); copy the file again")
    return config, {key: t.float() if t.is_floating_point() else t for key, t in state.items()}


def tensors_in(file: Any, path: Path) -> dict[str, Tensor]:
    """The tensors of an open file of safetensors.

    Args:
        path: of the file, for the message.
    Raises:
        CheckpointError: one is of a type that no network of ours computes with.
        SafetensorError: damaged, or of a type that the library does not know.
    """
    found = {}
    for key in file.keys():  # noqa: SIM118  (safe_open is no mapping)
        kind = str(file.get_slice(key).get_dtype())
        if kind not in _KINDS:
            raise CheckpointError(f"{path}: {key} is of type {kind}; store it as F32, F16 or BF16")
        found[key] = file.get_tensor(key)
    return found


def read_header(path: Path) -> dict[str, str]:
    """The strings in a checkpoint's header: at least format, name, type and config.

    Raises:
        CheckpointError: the file is missing, damaged, or not one of ours.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: no such weights; {_remedy(path)}")
    try:
        with safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path}: damaged ({error}); copy the file again") from error
    if header.get("format") != FORMAT or not {"name", "type", "config"} <= header.keys():
        raise CheckpointError(f"{path}: not a checkpoint of this program; choose one that it wrote")
    return header


def restore(module: nn.Module, state: dict[str, Tensor], path: Path) -> None:
    """Load `state` into `module`, every key and every shape.

    A module that was built on the meta device takes the tensors themselves, so that no weight is there twice.

    Args:
        path: where the state came from, for the message.
    Raises:
        CheckpointError: a key is missing, unmapped, or wrongly shaped.
    """
    own = module.state_dict()
    problems = [f"{key} is missing" for key in own.keys() - state.keys()]
    problems += [f"{key} belongs nowhere" for key in state.keys() - own.keys()]
    problems += [
        f"{key} is {tuple(state[key].shape)} instead of {tuple(own[key].shape)}"
        for key in own.keys() & state.keys()
        if own[key].shape != state[key].shape
    ]
    if problems:
        problems.sort()
        more = f" and {len(problems) - 3} more" if len(problems) > 3 else ""
        raise CheckpointError(f"{path}: {'; '.join(problems[:3])}{more}: made for another model; use its own weights")
    module.load_state_dict(state, assign=any(tensor.is_meta for tensor in own.values()))


def registered(name: str) -> Weights:
    """The registry's entry of that name.

    Raises:
        CheckpointError: there is none.
    """
    for weights in REGISTRY:
        if weights.name == name:
            return weights
    raise CheckpointError(f"{name}: no such weights; `python -m arm_blender weights list` names them")


def shipped(name: str, folder: Path | None = None) -> Path:
    """The file of registered weights: "small.georm" -> .../small.georm.safetensors. It need not exist.

    Args:
        folder: None for the one that `weights_folder` names.
    Raises:
        CheckpointError: no such name is registered.
    """
    return (folder or folder_of(name)) / registered(name).file_name


def verify(name: str, folder: Path | None = None) -> str:
    """Check a file against its recorded hash; returns its SHA-256.

    Raises:
        CheckpointError: the file is missing, or differs from the recorded hash.
    """
    path = shipped(name, folder)
    if path.suffix == SUFFIX:
        read_header(path)
    elif not path.is_file():
        raise CheckpointError(f"{path}: no such weights; {_remedy(path)}")
    found, recorded = sha256(path), recorded_sum(path)
    if found != recorded:
        place = f"{path.name}{SUM}" if registered(name).kind else SUMS
        what = "differs from" if recorded else "is not in"
        raise CheckpointError(f"{path}: {what} {place}; install the file again, or record it on purpose")
    return found


def condition(name: str, folder: Path | None = None) -> Literal["whole", "damaged", "not installed"]:
    """How registered weights lie in a folder; whole is what `verify` accepts."""
    if not shipped(name, folder).is_file():
        return "not installed"
    try:
        verify(name, folder)
    except CheckpointError:
        return "damaged"
    return "whole"


def record(path: Path) -> None:
    """Write the hash of what a user brought beside it, in the format of `sha256sum --check`.

    Raises:
        OutputError: the file cannot be written.
    """
    with whole_file(_beside(path)) as temporary:
        temporary.write_text(f"{sha256(path)}  {path.name}\n", encoding="utf-8")


def recorded_sum(path: Path) -> str | None:
    """The SHA-256 of weights as recorded beside them, or else in `SHA256SUMS`; None where it stands in neither."""
    for sums in (_beside(path), path.with_name(SUMS)):
        for line in sums.read_text(encoding="utf-8", errors="replace").splitlines() if sums.is_file() else ():
            # `sha256sum --binary` puts a star before the name. A line without a name records nothing.
            digest, _, name = line.partition(" ")
            if name.strip().removeprefix("*") == path.name:
                return digest
    return None


def _beside(path: Path) -> Path:
    return path.with_name(f"{path.name}{SUM}")


def sha256(path: Path) -> str:
    """Hex digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _is_finite(tensor: Tensor) -> bool:
    # The extremes are infinite, or no numbers, where any value is; unlike `isfinite` they need no memory of that size.
    return tensor.numel() == 0 or bool(torch.stack(tensor.aminmax()).isfinite().all())


def _remedy(path: Path) -> str:
    return next((w.remedy for w in REGISTRY if w.file_name == path.name), "check the path")
