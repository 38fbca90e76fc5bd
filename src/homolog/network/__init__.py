"""DiffusionNet, and its weights on disk."""

from homolog.network.augmentation import AugmentationSettings, augmented
from homolog.network.diffusion_net import DiffusionNet, GradientProduct, NetworkSettings, heat_decay
from homolog.network.weights import DEFAULT_WEIGHTS, WeightsInfo, load_weights, save_weights, shipped_weights

__all__ = [
    "DEFAULT_WEIGHTS",
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
