"""Gymnasium environments with the simulated sensor in MuJoCo, and many simulated sensors of one scene at once."""
