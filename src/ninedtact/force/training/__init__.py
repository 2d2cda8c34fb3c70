"""Training of force models: examples → one ONNX file that says all about itself.

run.py            `train`, the whole of it; read this first
settings.py       what is asked for, and the presets `paper` and `ours`
examples.py       what is learnt from, in memory or mapped; batches.py some of it at a time, in an order that a seed decides
augmentation.py   the same touch seen otherwise: geometry.py image and wrench alike, disturbance.py the image alone
learner.py        one step and its loss; fit.py all steps; history.py what is noted of each epoch
folder.py         where it is kept; checkpoints.py, manners.py how it is gone on with after a stop
lesson.py         what it comes to: intervals.py errors that cover what they claim, an evaluation, the card
export.py         to ONNX; curves.py an image of the training

Built on Lightning: accelerator, devices, nodes and precision are its own flags (`settings.Machine`).
"""
