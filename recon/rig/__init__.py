"""The synthetic capture rig: recordings with known truth, in exactly the PLUSH layout."""
