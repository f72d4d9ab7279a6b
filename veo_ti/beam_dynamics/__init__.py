"""What a quasi-static simulation of the silicone beam gets wrong in the seconds after its release, and why."""
