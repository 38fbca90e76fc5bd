"""Experiments of the paper, from datasets to tables.

A name is imported when it is first used: experiments are listed without PyTorch.
"""

from typing import TYPE_CHECKING

from homolog.core.lazy import lazy_names

if TYPE_CHECKING:
    from homolog.reproduction.experiments import (
        COLUMNS,
        Column,
        DataPlace,
        Experiment,
        Row,
        TrainingPlan,
        data_places,
        experiment_names,
        read_experiment,
        trainings,
    )
    from homolog.reproduction.report import write_report
    from homolog.reproduction.run import Reproduced, ReproductionSettings, reproduce

__all__ = [
    "COLUMNS",
    "Column",
    "DataPlace",
    "Experiment",
    "Reproduced",
    "ReproductionSettings",
    "Row",
    "TrainingPlan",
    "data_places",
    "experiment_names",
    "read_experiment",
    "reproduce",
    "trainings",
    "write_report",
]

_MODULES = {
    "COLUMNS": "experiments",
    "Column": "experiments",
    "DataPlace": "experiments",
    "Experiment": "experiments",
    "Reproduced": "run",
    "ReproductionSettings": "run",
    "Row": "experiments",
    "TrainingPlan": "experiments",
    "data_places": "experiments",
    "experiment_names": "experiments",
    "read_experiment": "experiments",
    "reproduce": "run",
    "trainings": "experiments",
    "write_report": "report",
}
__getattr__ = lazy_names(__name__, _MODULES)
