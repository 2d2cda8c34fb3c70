"""Designs compared before anything is printed: what each would measure, weigh and cost."""
