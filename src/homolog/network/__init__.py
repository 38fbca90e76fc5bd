"""DiffusionNet, and its weights on disk."""

from homolog.network.diffusion_net import DiffusionNet, GradientProduct, NetworkSettings, diffuse
from homolog.network.weights import WeightsInfo, find_weights, load_weights, save_weights, shipped_weights

__all__ = [
    "DiffusionNet",
    "GradientProduct",
    "NetworkSettings",
    "WeightsInfo",
    "diffuse",
    "find_weights",
    "load_weights",
    "save_weights",
    "shipped_weights",
]
