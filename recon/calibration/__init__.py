"""Cameras, lenses and the rig from views of boards: detection, first poses along chains, bundle adjustment."""
