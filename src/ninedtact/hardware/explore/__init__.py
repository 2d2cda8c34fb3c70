"""Comparison of designs before anything is printed: a hardware design and values to vary go in, what each combination
would measure, weigh and cost comes out.

`design_sweep.explore_designs` yields the designs and formats their comparison as text, CSV and a plot;
`performance_prediction` predicts the performance of one design.
"""
