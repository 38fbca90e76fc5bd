"""DiffusionNet, and its weights on disk."""

from homolog.core.pretrained import DEFAULT_WEIGHTS, pretrained_weights
from homolog.features.augmentation import AugmentationSettings, augmented
from homolog.features.diffusion_net import DiffusionNet, GradientProduct, NetworkSettings, heat_decay
from homolog.features.weights import WeightsInfo, load_weights, save_weights

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
    "pretrained_weights",
    "save_weights",
]
