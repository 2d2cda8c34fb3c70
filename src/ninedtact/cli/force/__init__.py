"""Force at the command line: estimating, adapting to a weighed press, judging, training, and the model that ships."""
