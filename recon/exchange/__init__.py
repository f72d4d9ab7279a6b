"""Other layouts: nerfstudio in and out, COLMAP text out."""
