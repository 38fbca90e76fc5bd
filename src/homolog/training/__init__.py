"""Learning the network from shapes alone."""

from homolog.training.objective import Losses, LossSettings, TrainingShape, pair_losses

__all__ = ["LossSettings", "Losses", "TrainingShape", "pair_losses"]
