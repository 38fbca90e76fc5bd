"""Learning the network from shapes alone: recipes, losses, the loop, checkpoints."""

from homolog.training.adaptation import AdaptationSettings, adapt_if_better, adapt_to_pair, adapt_to_pairs
from homolog.training.augmentation import augmented
from homolog.training.distributed import is_started_by_another
from homolog.training.lending import LentOrienter, lent_orienter
from homolog.training.loop import is_first_process, train
from homolog.training.losses import BUILTIN_LOSSES, Loss
from homolog.training.objective import losses_of, pair_losses
from homolog.training.orienter import train_orienter
from homolog.training.quantities import QUANTITIES, PairQuantities, QuantitySettings, TrainingShape
from homolog.training.recipes import builtin_recipes, find_recipe, read_recipe
from homolog.training.run_folder import RUN_FILES, WEIGHTS, is_begun
from homolog.training.settings import (
    AugmentationSettings,
    CloudSettings,
    DataSettings,
    LossSettings,
    OptimiserSettings,
    OrienterSettings,
    PartialSettings,
    Recipe,
    SampleSettings,
    TrainingSettings,
    ValidationSettings,
)
from homolog.training.state import TrainingState

__all__ = [
    "BUILTIN_LOSSES",
    "QUANTITIES",
    "RUN_FILES",
    "WEIGHTS",
    "AdaptationSettings",
    "AugmentationSettings",
    "CloudSettings",
    "DataSettings",
    "LentOrienter",
    "Loss",
    "LossSettings",
    "OptimiserSettings",
    "OrienterSettings",
    "PairQuantities",
    "PartialSettings",
    "QuantitySettings",
    "Recipe",
    "SampleSettings",
    "TrainingSettings",
    "TrainingShape",
    "TrainingState",
    "ValidationSettings",
    "adapt_if_better",
    "adapt_to_pair",
    "adapt_to_pairs",
    "augmented",
    "builtin_recipes",
    "find_recipe",
    "is_begun",
    "is_first_process",
    "is_started_by_another",
    "lent_orienter",
    "losses_of",
    "pair_losses",
    "read_recipe",
    "train",
    "train_orienter",
]
