"""Commands about force: estimate, adapt, evaluate, train and model. Options go in, a report is printed."""
