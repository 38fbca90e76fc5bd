"""DiffusionNet, and its weights on disk."""

from homolog.network.augmentation import AugmentationSettings, augmented
from homolog.network.diffusion_net import DiffusionNet, GradientProduct, NetworkSettings, heat_decay
from homolog.network.weights import WeightsInfo, load_weights, save_weights, shipped_weights

__all__ = [
    "AugmentationSettings",
    "DiffusionNet",
    "GradientProduct",
    "NetworkSettings",
    "WeightsInfo",
    "augmented",
    "heat_decay",
    "load_weights",
    "save_weights",
    "shipped_weights",
]
