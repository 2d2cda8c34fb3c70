"""Jobs that run across packages: train a force model from simulation alone, evaluate an estimator on a data set, calibrate
a sensor's force.

Data sets, sensor folders and images go in; predictions, trained models, model cards and force calibrations come out.

dataset_calibrations.py  `load_dataset_sensors`: the calibration of every sensor of a data set
dataset_training.py      `train_on_dataset`: a force model from a data set
dataset_evaluation.py    `predict_dataset`: an estimator's wrenches on a data set; the tables of a model card
force_calibration.py     `calibrate_force`: the force scale of a sensor from presses with known loads, real or simulated
force_model_from_simulation.py  `make_force_model`: simulate, train and validate a force model

The modules load torch, the simulation and the data-set libraries, so this file exports nothing.
"""
