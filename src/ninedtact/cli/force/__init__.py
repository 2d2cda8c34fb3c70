"""Commands about force: estimate, calibrate-force, evaluate, train and model. Options go in, a report is printed."""
