"""Teaching of force models for the 9DTact sensor: data sets go in or are simulated, trained and evaluated models come out.

collecting    pairs of image and wrench from pressing objects by hand, with a force/torque sensor
population    many simulated sensors, sampled or as fitted to real ones
batched       their contacts solved and rendered many at a time
dataset       one schema for pairs of all sources; data sets built, checked, generated and read
training      networks, their training and their model cards
evaluation    scores of predicted wrenches
environments  Gymnasium environments with the simulated sensor in MuJoCo
workflows     jobs that run across these packages
cli           the commands `collect`, `dataset`, `simulate dataset`, `train`, `model` and `evaluate`
"""
