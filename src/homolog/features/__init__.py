"""Features per point: the extractor that computes them, DiffusionNet, and its weights on disk."""

from homolog.core.pretrained import DEFAULT_WEIGHTS, pretrained_weights
from homolog.features.diffusion_net import DiffusionNet, GradientProduct, NetworkSettings, heat_decay
from homolog.features.extractor import (
    FeatureExtractor,
    FunctionFeatures,
    NetworkFeatures,
    as_extractor,
    checked_features,
    computed_features,
    network_input,
    on_device,
)
from homolog.features.info import FeatureInfo, NetworkInput
from homolog.features.orienter import (
    ORIENTER_EIGENPAIRS,
    ORIENTER_NETWORK,
    ORIENTER_RADIUS,
    ORIENTER_SAMPLES,
    Orientation,
    Orienter,
    as_oriented,
    orienter_frame,
)
from homolog.features.weights import load_weights, save_weights

__all__ = [
    "DEFAULT_WEIGHTS",
    "ORIENTER_EIGENPAIRS",
    "ORIENTER_NETWORK",
    "ORIENTER_RADIUS",
    "ORIENTER_SAMPLES",
    "DiffusionNet",
    "FeatureExtractor",
    "FeatureInfo",
    "FunctionFeatures",
    "GradientProduct",
    "NetworkFeatures",
    "NetworkInput",
    "NetworkSettings",
    "Orientation",
    "Orienter",
    "as_extractor",
    "as_oriented",
    "checked_features",
    "computed_features",
    "heat_decay",
    "load_weights",
    "network_input",
    "on_device",
    "orienter_frame",
    "pretrained_weights",
    "save_weights",
]
