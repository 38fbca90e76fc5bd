"""Learning the network from shapes alone: recipes, losses, the loop, checkpoints."""

from homolog.training.loop import is_first_process, train
from homolog.training.objective import Losses, LossSettings, TrainingShape, pair_losses
from homolog.training.recipe import Recipe, find_recipe, read_recipe, shipped_recipes
from homolog.training.run_folder import WEIGHTS
from homolog.training.state import TrainingState

__all__ = [
    "WEIGHTS",
    "LossSettings",
    "Losses",
    "Recipe",
    "TrainingShape",
    "TrainingState",
    "find_recipe",
    "is_first_process",
    "pair_losses",
    "read_recipe",
    "shipped_recipes",
    "train",
]
