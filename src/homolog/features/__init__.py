"""DiffusionNet, and its weights on disk."""

from homolog.features.diffusion_net import DiffusionNet, GradientProduct, NetworkSettings, heat_decay
from homolog.features.weights import DEFAULT_WEIGHTS, WeightsInfo, load_weights, pretrained_weights, save_weights

__all__ = [
    "DEFAULT_WEIGHTS",
    "DiffusionNet",
    "GradientProduct",
    "NetworkSettings",
    "WeightsInfo",
    "heat_decay",
    "load_weights",
    "pretrained_weights",
    "save_weights",
]
