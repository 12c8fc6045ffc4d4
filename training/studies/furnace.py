"""The white furnace: how much of uniform light a white surface sends on, by each form of the BRDF."""

import math
from pathlib import Path
from typing import get_args

import torch
from torch import Tensor

from arm_blender.graphics.light.brdf import Form, evaluate

from .figures import panels

COSINES = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


def polar_quadrature(count: int) -> tuple[Tensor, Tensor]:
    """(count,) angles from the normal, crowded towards it, and their weights sin(theta) d(theta)."""
    t = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    theta = t**3 * math.pi / 2
    return theta, theta.sin() * 3 * t**2 * math.pi / 2 / count


def furnace(roughness: float, metallic: float, n_dot_v: float, form: Form) -> float:
    """Light that a white surface sends to the view out of uniform light of 1: the integral of BRDF times cosine.

    Taken over half-way vectors, where the lobe is smooth; dl = 4 (h.v) dh.
    """
    theta, weight = polar_quadrature(400)
    phi = (torch.arange(128, dtype=torch.float64) + 0.5) / 128 * 2 * math.pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    half = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], dim=-1)
    view = torch.tensor([math.sqrt(1 - n_dot_v**2), 0.0, n_dot_v], dtype=torch.float64)
    h_dot_v = (half * view).sum(dim=-1, keepdim=True)
    light = 2 * h_dot_v * half - view
    normal, one = torch.tensor([0.0, 0.0, 1.0]).double(), torch.ones(1).double()
    value = evaluate(normal, light, view, torch.ones(3).double(), one * roughness, one * metallic, form)
    solid_angle = weight[:, None, None] * (2 * math.pi / 128) * 4 * h_dot_v.clamp(min=0)
    return float((value * light[..., 2:].clamp(min=0) * solid_angle).sum(dim=(0, 1))[0])


def plot(path: Path) -> None:
    """A panel for plastic and one for metal: what comes back at every angle, at three degrees of roughness."""
    with panels(path, 2, 10.0, 3.8) as (plastic, metal):
        for panel, metallic, title in ((plastic, 0.0, "White plastic"), (metal, 1.0, "White metal: the lobe alone")):
            for form, style in zip(get_args(Form), ("-", ":", "--"), strict=True):
                for roughness, color in ((0.2, "tab:blue"), (0.5, "tab:orange"), (0.9, "tab:green")):
                    found = [furnace(roughness, metallic, cosine, form) for cosine in COSINES]
                    panel.plot(COSINES, found, style, color=color, label=f"{form}, roughness {roughness}")
            panel.axhline(1.0, color="0.6", linewidth=0.8)
            panel.set(xlabel="cosine of the view", title=title, ylim=(0.0, 3.0))
            panel.grid(alpha=0.3)
        plastic.legend(fontsize=6.5, ncols=3, loc="upper center")
