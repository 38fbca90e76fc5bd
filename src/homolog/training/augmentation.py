"""Varying the network's input in training: turns, scales and jitter of the positions. Operators stay as they are."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.training.settings import AugmentationSettings


def augmented(
    points: Float[Tensor, "n 3"], settings: AugmentationSettings, generator: torch.Generator | None = None
) -> Float[Tensor, "n 3"]:
    """Positions turned, stretched, shifted and jittered at random, by torch's own generator if none is given."""
    moved = points @ _turn(settings, generator).T.to(points)
    if settings.tilt:  # about a horizontal axis, each direction and each angle as likely
        share, direction = _uniform(2, generator)
        half, around = torch.deg2rad(settings.tilt * share) / 2, 2 * torch.pi * direction
        quaternion = [half.cos(), half.sin() * around.cos(), torch.zeros(()), half.sin() * around.sin()]
        moved = moved @ rotation_of(torch.stack(quaternion)).T.to(points)
    low, high = settings.least_scale, settings.most_scale
    moved = moved * (low + (high - low) * _uniform(3, generator)).to(points)
    if settings.shift:
        moved = moved + settings.shift * torch.randn(3, generator=generator, device=_device(generator)).to(points)
    if not settings.jitter:
        return moved
    noise = torch.randn(points.shape, generator=generator, device=_device(generator)).to(points)
    return moved + (settings.jitter * noise).clamp_(-settings.largest_jitter, settings.largest_jitter)


def _turn(settings: AugmentationSettings, generator: torch.Generator | None) -> Float[Tensor, "3 3"]:
    if settings.turn == "none":
        return torch.eye(3)
    if settings.turn == "any":
        return rotation_of(torch.randn(4, generator=generator, device=_device(generator)).cpu())
    half = torch.deg2rad(settings.degrees * (2 * _uniform(1, generator)[0] - 1)) / 2
    return rotation_of(torch.stack([half.cos(), torch.zeros(()), half.sin(), torch.zeros(())]))


def rotation_of(quaternion: Float[Tensor, 4]) -> Float[Tensor, "3 3"]:
    """The rotation of a quaternion of any length; those in random directions give all rotations as likely."""
    w, x, y, z = quaternion / quaternion.norm()
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row) for row in rows])


def _uniform(count: int, generator: torch.Generator | None) -> Float[Tensor, " c"]:
    return torch.rand(count, generator=generator, device=_device(generator)).cpu()


def _device(generator: torch.Generator | None) -> torch.device:
    return torch.device("cpu") if generator is None else generator.device
