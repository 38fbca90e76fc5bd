"""DiffusionNet, and its weights on disk."""

from homolog.network.diffusion_net import DiffusionNet, GradientProduct, NetworkSettings, diffuse
from homolog.network.weights import WeightsInfo, load_weights, save_weights

__all__ = [
    "DiffusionNet",
    "GradientProduct",
    "NetworkSettings",
    "WeightsInfo",
    "diffuse",
    "load_weights",
    "save_weights",
]
