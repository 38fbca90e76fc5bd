"""Learning the network from shapes alone: recipes, losses, the loop, checkpoints."""

from homolog.training.adaptation import AdaptationSettings, adapt_to_pair
from homolog.training.loop import is_first_process, train
from homolog.training.objective import Losses, LossSettings, TrainingShape, pair_losses
from homolog.training.recipe import Recipe, builtin_recipes, find_recipe, read_recipe
from homolog.training.run_folder import WEIGHTS
from homolog.training.state import TrainingState
from homolog.training.together import is_started_by_another

__all__ = [
    "WEIGHTS",
    "AdaptationSettings",
    "LossSettings",
    "Losses",
    "Recipe",
    "TrainingShape",
    "TrainingState",
    "adapt_to_pair",
    "builtin_recipes",
    "find_recipe",
    "is_first_process",
    "is_started_by_another",
    "pair_losses",
    "read_recipe",
    "train",
]
