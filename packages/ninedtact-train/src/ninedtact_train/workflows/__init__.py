"""Jobs that run across packages: train a force model, also from simulation alone, and evaluate an estimator on a data set.

Data sets and sensor folders go in; predictions, trained models and model cards come out.

dataset_calibrations.py  `load_dataset_sensors`: the calibration of every sensor of a data set
dataset_training.py      `train_on_dataset`: a force model from a data set
dataset_evaluation.py    `predict_dataset`: an estimator's wrenches on a data set; the tables of a model card
force_model_from_simulation.py  `make_force_model`: simulate, train and validate a force model

The modules load torch, the simulation and the data-set libraries, so this file exports nothing.
"""
