"""What `veo reconstruct` does: a recording becomes a field that can be rendered and a cloud in correspondence."""
