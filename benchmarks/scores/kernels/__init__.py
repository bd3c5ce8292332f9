"""Kernels of scores: the Kalman filter along a system of equations."""
