"""Training: Recipe (typed settings), the shapes made ready, the loop, checkpoints."""

from homolog.training.loop import is_first_process, train
from homolog.training.recipe import Recipe, find_recipe, read_recipe, shipped_recipes
from homolog.training.run_folder import WEIGHTS
from homolog.training.state import TrainingState

__all__ = [
    "WEIGHTS",
    "Recipe",
    "TrainingState",
    "find_recipe",
    "is_first_process",
    "read_recipe",
    "shipped_recipes",
    "train",
]
