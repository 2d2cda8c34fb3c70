"""Training of force models: examples (heights or images with wrenches) go in, one ONNX file with its model card comes out.

train.py             `train_network`: the whole training; read this first
settings.py          the settings of a training, and the presets `default` and `paper`
examples.py          the examples, in memory or mapped from a file, and their batches in a seeded order
augmentation.py      random changes of an example: geometric ones of image and wrench, and perturbations of the image alone
training_loop.py     loss and optimisation steps, validation, checkpoints and metrics of every epoch
trained_network.py   the scale of errors calibrated, the evaluation on held-out pairs, and the model card
onnx_export.py       the network with its card as one ONNX file

Lightning Fabric runs the loop: accelerator, devices, nodes, strategy and precision are its flags (`ComputeSettings`).
Importing a module of this package loads torch, so this file exports nothing.
"""
