"""Reconstruction side: recordings, cameras and the layouts they are stored in; it knows no energy."""
