"""Noise levels and steps of the ancestral Euler sampler (Karras et al., arXiv:2206.00364, algorithm 2, in k-diffusion's
form), for a network that predicts v (Salimans and Ho, arXiv:2202.00512).

Held against the fixture of diffusers' EulerAncestralDiscreteScheduler; ours, because each view brings its own noise.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor


@dataclass(frozen=True)
class NoiseConfig:
    """What a network was trained to see as noise; of scheduler_config.json. A wrong one leaves noise in the views."""

    num_train_timesteps: int = 1000
    """Noise levels of the training."""
    beta_start: float = 0.00085
    """Variance that the first level adds."""
    beta_end: float = 0.012
    """Variance that the last level adds."""
    beta_schedule: Literal["linear", "scaled_linear"] = "linear"
    """Whether the variance grows evenly, or its root."""

    def alphas_cumprod(self) -> Tensor:
        """(num_train_timesteps,) float64: the share of the picture in the variance at each level."""
        power = {"linear": 1.0, "scaled_linear": 0.5}[self.beta_schedule]
        ends = self.beta_start**power, self.beta_end**power
        betas = torch.linspace(*ends, self.num_train_timesteps, dtype=torch.float64) ** (1.0 / power)
        return torch.cumprod(1.0 - betas, dim=0)


@dataclass(frozen=True)
class Schedule:
    """The levels that a run goes through, from noise to picture.

    A sample at level k is the picture plus noise of standard deviation `sigmas[k]`.

    Attributes:
        timesteps: S levels of the training, what the network is told.
        sigmas: S + 1 standard deviations; the last is 0.
    """

    timesteps: tuple[int, ...]
    sigmas: tuple[float, ...]

    @property
    def initial_sigma(self) -> float:
        """Standard deviation of the noise that a run starts from."""
        return self.sigmas[0]

    def noised(self, picture: Tensor, noise: Tensor, k: int) -> Tensor:
        """`picture` with `noise` of unit variance, at level k."""
        return picture + noise * self.sigmas[k]

    def scaled(self, sample: Tensor, k: int) -> Tensor:
        """A sample at level k as the network takes it: of unit variance."""
        return sample / math.sqrt(self.sigmas[k] ** 2 + 1.0)

    def picture(self, sample: Tensor, v: Tensor, k: int) -> Tensor:
        """The picture without noise that the network's `v` means for a sample at level k."""
        sigma = self.sigmas[k]
        return sample / (sigma**2 + 1.0) - v * (sigma / math.sqrt(sigma**2 + 1.0))

    def step(self, sample: Tensor, v: Tensor, noise: Tensor, k: int) -> Tensor:
        """The sample at level k + 1.

        Args:
            sample: at level k, any shape.
            v: the network's prediction, as `sample`.
            noise: of unit variance, as `sample`: what the step adds after having gone below its level.
            k: 0 to S - 1.
        """
        now, then = self.sigmas[k], self.sigmas[k + 1]
        up = math.sqrt(then**2 * (now**2 - then**2)) / now
        down = math.sqrt(then**2 - up**2)
        direction = (sample - self.picture(sample, v, k)) / now
        return sample + direction * (down - now) + noise * up


def schedule(config: NoiseConfig, steps: int) -> Schedule:
    """`steps` levels, spaced evenly from the last one of the training ("trailing").

    Raises:
        ValueError: steps is not 1 to config.num_train_timesteps.
    """
    levels = config.num_train_timesteps
    if not 1 <= steps <= levels:
        raise ValueError(f"steps must be 1 to {levels}, got {steps}")
    alphas = config.alphas_cumprod()
    sigmas = ((1.0 - alphas) / alphas).sqrt()
    timesteps = tuple(round(levels - index * levels / steps) - 1 for index in range(steps))
    return Schedule(timesteps, (*(float(sigmas[timestep]) for timestep in timesteps), 0.0))
