"""Differentiable meshless elasticity: points, forces and energies in SI units; no camera, no torch, no file."""

import os

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")  # Taichi reads both when it is first imported
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "1")
