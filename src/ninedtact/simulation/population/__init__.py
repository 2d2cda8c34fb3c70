"""A distribution over sensors, to train and to judge what must work on a sensor that it has not seen.

member.py     member k of a seed: all numbers of one sensor, its twin, its way to and from JSON; read this first
spread.py     how the numbers of light, gel and lens spread over real sensors; parts.py the rest
mechanics.py  what lies below the skin: gel on a rigid base, on one that yields, or gel that stiffens as it thins
"""
